//! Times of repeated work, peak memory, and the machine they belong to.

use serde::{Deserialize, Serialize};
use std::time::Instant;

/// Seconds of repeated work.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Times {
    /// Median.
    pub(crate) median_s: f64,
    /// Shortest.
    pub(crate) min_s: f64,
    /// Longest.
    pub(crate) max_s: f64,
    /// Median processor time over all threads, where the system tells.
    pub(crate) cpu_s: Option<f64>,
    /// Repetitions.
    pub(crate) n: usize,
}

impl Times {
    /// Of these seconds.
    pub(crate) fn of(seconds: &[f64]) -> Times {
        Times {
            median_s: median(seconds),
            min_s: seconds.iter().copied().fold(f64::INFINITY, f64::min),
            max_s: seconds.iter().copied().fold(0.0, f64::max),
            cpu_s: None,
            n: seconds.len(),
        }
    }

    /// The same less so many seconds.
    pub(crate) fn less(&self, seconds: f64) -> Times {
        let less = |s: f64| s - seconds;
        let [median_s, min_s, max_s] = [self.median_s, self.min_s, self.max_s].map(less);
        Times { median_s, min_s, max_s, ..self.clone() }
    }
}

/// Does `work` `repeat` times and returns its last result.
pub(crate) fn timed<T, E>(
    repeat: usize,
    mut work: impl FnMut() -> Result<T, E>,
) -> Result<(Times, T), E> {
    let (mut wall, mut cpu) = (Vec::new(), Vec::new());
    loop {
        let (start, before) = (Instant::now(), cpu_seconds());
        let result = work()?;
        wall.push(start.elapsed().as_secs_f64());
        cpu.extend(before.zip(cpu_seconds()).map(|(before, after)| after - before));
        if wall.len() >= repeat {
            let cpu_s = (cpu.len() == wall.len()).then(|| median(&cpu));
            return Ok((Times { cpu_s, ..Times::of(&wall) }, result));
        }
    }
}

/// The middle one, or the mean of the two.
pub(crate) fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => f64::NAN,
        n => 0.5 * (sorted[(n - 1) / 2] + sorted[n / 2]),
    }
}

/// Processor time of all threads of this process so far: the scheduler's own count, which unlike
/// the clock ticks of `times` resolves microseconds.
fn cpu_seconds() -> Option<f64> {
    let mut nanoseconds = 0u64;
    for task in std::fs::read_dir("/proc/self/task").ok()? {
        let text = std::fs::read_to_string(task.ok()?.path().join("schedstat")).ok()?;
        nanoseconds += text.split_whitespace().next()?.parse::<u64>().ok()?;
    }
    Some(nanoseconds as f64 * 1e-9)
}

/// Most memory that this process has had resident, in bytes.
pub(crate) fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? * 1024)
}

/// What the figures were measured on.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Machine {
    /// Model of the processor.
    pub(crate) cpu: String,
    /// Hardware threads that this process may use.
    pub(crate) n_threads: usize,
    /// Vector extensions.
    pub(crate) vectors: Vec<String>,
    /// Memory in bytes.
    pub(crate) memory_bytes: u64,
    /// Load average over a minute when the program started.
    pub(crate) load_average: f64,
}

impl Machine {
    /// This one.
    pub(crate) fn here() -> Machine {
        let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
        let cpuinfo = read("/proc/cpuinfo");
        let field = |name: &str| {
            let mut lines = cpuinfo.lines().filter_map(|line| line.split_once(':'));
            lines.find(|(key, _)| key.trim() == name).map(|(_, value)| value.trim().to_owned())
        };
        let flags = field("flags").unwrap_or_default();
        let is_vector = |flag: &&str| {
            ["sse2", "avx", "avx2", "fma"].contains(flag) || flag.starts_with("avx512")
        };
        let meminfo = read("/proc/meminfo");
        let memory_kb = meminfo
            .lines()
            .find_map(|line| line.strip_prefix("MemTotal:"))
            .and_then(|rest| rest.split_whitespace().next()?.parse::<u64>().ok());
        Machine {
            cpu: field("model name").unwrap_or_else(|| std::env::consts::ARCH.into()),
            n_threads: std::thread::available_parallelism().map_or(1, usize::from),
            vectors: flags.split_whitespace().filter(is_vector).map(str::to_owned).collect(),
            memory_bytes: memory_kb.unwrap_or(0) * 1024,
            load_average: read("/proc/loadavg")
                .split_whitespace()
                .next()
                .and_then(|load| load.parse().ok())
                .unwrap_or(f64::NAN),
        }
    }
}

/// A number that has to stay within a limit for the figures to mean anything.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Check {
    /// What was checked.
    pub(crate) what: String,
    /// What was found.
    pub(crate) value: f64,
    /// The most that is right.
    pub(crate) limit: f64,
}

impl Check {
    /// `value` may be at most `limit`.
    pub(crate) fn at_most(what: impl Into<String>, value: f64, limit: f64) -> Check {
        Check { what: what.into(), value, limit }
    }

    /// Whether it holds (not for a number that is none).
    pub(crate) fn holds(&self) -> bool {
        self.value <= self.limit
    }
}
