//! Closing the incision: one round of stitches, made by every method and held side by side.

use super::console::Console;
use super::error::{DemoError, Doing};
use serde::Serialize;
use std::time::Instant;
use sutura_client::proto::edit::{Edit, EditMethod, EditReply, EditRequest};
use sutura_client::{BusSession, Session};

/// Frequencies shown of each generation.
const N_SHOWN: usize = 10;

/// Of the table of methods: the worst residual of the lower half of the modes and of all, the
/// cubature's relative force error on held-out poses, and times.
const COLUMNS: [&str; 9] = [
    "method",
    "residual",
    "residual",
    "cubature",
    "linear",
    "derivatives",
    "reduction",
    "cubature",
    "total",
];

/// The session to be closed and two forks of it that are closed by the other methods, so that
/// all three start every round from their own previous one.
pub(crate) struct Patients<'a> {
    pub(crate) main: &'a Session,
    /// The same session as `main`.
    pub(crate) main_on_bus: &'a BusSession,
    pub(crate) low_rank: &'a Session,
    pub(crate) from_scratch: &'a Session,
}

/// How an edit reaches the daemon.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Way {
    Http,
    Zenoh,
}

/// One generation made by one method.
#[derive(Serialize)]
pub(crate) struct MethodReport {
    /// From sending the request to having the reply, in ms.
    pub(crate) wall_ms: f64,
    pub(crate) reply: EditReply,
}

impl MethodReport {
    fn worst_residual(&self) -> f64 {
        self.reply.residuals.iter().copied().fold(0.0, f64::max)
    }

    fn worst_residual_lower_half(&self) -> f64 {
        let half = self.reply.residuals.len().div_ceil(2);
        self.reply.residuals.iter().take(half).copied().fold(0.0, f64::max)
    }
}

/// One round.
#[derive(Serialize)]
pub(crate) struct RoundReport {
    pub(crate) round: usize,
    pub(crate) n_new_stitches: usize,
    /// How the `flexibility` edit travelled; the others went over HTTP.
    pub(crate) way: Way,
    pub(crate) frequencies_hz_before: Vec<f64>,
    pub(crate) low_rank: MethodReport,
    pub(crate) flexibility: MethodReport,
    pub(crate) from_scratch: MethodReport,
    /// Largest relative difference of `flexibility` from `from_scratch`, over the first ten.
    pub(crate) max_relative_difference: f64,
    /// Largest residual of the `flexibility` modes, over their lower half, which the tolerance
    /// governs, and over all.
    pub(crate) worst_residual_lower_half: f64,
    pub(crate) worst_residual: f64,
    /// Time of `from_scratch` over that of `flexibility`, as the daemon measured them.
    pub(crate) speed_up: f64,
}

/// Makes the stitches `pairs` by every method.
pub(crate) async fn close(
    patients: &Patients<'_>,
    way: Way,
    round: usize,
    pairs: &[[u32; 2]],
    stiffness_n_m: f64,
    frequencies_hz_before: Vec<f64>,
) -> Result<RoundReport, DemoError> {
    let request = |method| EditRequest {
        method,
        ..EditRequest::new(vec![Edit::Stitch { pairs: pairs.to_vec(), stiffness_n_m }])
    };
    let start = Instant::now();
    let reply = match way {
        Way::Http => patients.main.edit(&request(EditMethod::Flexibility)).await,
        Way::Zenoh => patients.main_on_bus.edit(&request(EditMethod::Flexibility)).await,
    };
    let flexibility = timed(start, reply.doing("stitching by flexibility")?);
    let start = Instant::now();
    let reply = patients.low_rank.edit(&request(EditMethod::LowRank)).await;
    let low_rank = timed(start, reply.doing("stitching by low_rank")?);
    let start = Instant::now();
    let reply = patients.from_scratch.edit(&request(EditMethod::FromScratch)).await;
    let from_scratch = timed(start, reply.doing("stitching from scratch")?);

    let pairs_hz = flexibility.reply.frequencies_hz.iter().zip(&from_scratch.reply.frequencies_hz);
    let differences = pairs_hz.take(N_SHOWN).map(|(ours, exact)| (ours / exact - 1.0).abs());
    Ok(RoundReport {
        round,
        n_new_stitches: pairs.len(),
        way,
        frequencies_hz_before,
        max_relative_difference: differences.fold(0.0, f64::max),
        worst_residual_lower_half: flexibility.worst_residual_lower_half(),
        worst_residual: flexibility.worst_residual(),
        speed_up: from_scratch.reply.timings_ms.total / flexibility.reply.timings_ms.total,
        low_rank,
        flexibility,
        from_scratch,
    })
}

fn timed(start: Instant, reply: EditReply) -> MethodReport {
    MethodReport { wall_ms: 1e3 * start.elapsed().as_secs_f64(), reply }
}

impl RoundReport {
    fn methods(&self) -> [(&'static str, &MethodReport); 3] {
        [
            ("low_rank", &self.low_rank),
            ("flexibility", &self.flexibility),
            ("from_scratch", &self.from_scratch),
        ]
    }

    /// Prints the tables.
    pub(crate) fn print(&self, console: Console) {
        let way = match self.way {
            Way::Http => "HTTP",
            Way::Zenoh => "a Zenoh query",
        };
        console.heading(&format!(
            "Round {}: {} stitches over {way} → generation {}",
            self.round, self.n_new_stitches, self.flexibility.reply.generation
        ));
        console
            .line("  mode     before   low_rank  flexibility  from_scratch   flexibility off by");
        console.line("               Hz         Hz           Hz            Hz");
        let columns = [
            &self.frequencies_hz_before,
            &self.low_rank.reply.frequencies_hz,
            &self.flexibility.reply.frequencies_hz,
            &self.from_scratch.reply.frequencies_hz,
        ];
        for mode in 0..columns.iter().map(|c| c.len()).max().unwrap_or(0).min(N_SHOWN) {
            let [before, low_rank, flexibility, from_scratch] =
                columns.map(|column| column.get(mode).copied());
            let off = match (flexibility, from_scratch) {
                (Some(ours), Some(exact)) => format!("{:.1e}", (ours / exact - 1.0).abs()),
                _ => "–".to_owned(),
            };
            console.line(&format!(
                "  {:4} {:>10} {:>10} {:>12} {:>13}   {off}",
                mode + 1,
                hertz(before),
                hertz(low_rank),
                hertz(flexibility),
                hertz(from_scratch),
            ));
        }
        console.line("");
        let units = ["", "low half", "all", "held-out error", "ms", "ms", "ms", "ms", "ms"];
        console.line(&row(COLUMNS));
        console.line(&row(units));
        for (name, method) in self.methods() {
            let residuals = [method.worst_residual_lower_half(), method.worst_residual()];
            let [half, all] = residuals.map(|residual| format!("{residual:.1e}"));
            let cubature = method.reply.cubature.map_or("–".to_owned(), |cubature| {
                let source = serde_json::to_value(cubature.source).unwrap_or_default();
                let source = source.as_str().unwrap_or_default().to_owned();
                format!("{source} {:.3}", cubature.validation_error)
            });
            let ms = &method.reply.timings_ms;
            let times = [ms.linear, ms.derivatives, ms.reduction, ms.cubature, ms.total];
            let [linear, derivatives, reduction, fit, total] = times.map(|ms| format!("{ms:.0}"));
            console.line(&row([
                name,
                &half,
                &all,
                &cubature,
                &linear,
                &derivatives,
                &reduction,
                &fit,
                &total,
            ]));
        }
        for (name, method) in self.methods() {
            for warning in &method.reply.warnings {
                console.line(&format!("  {name}: {warning}"));
            }
        }
        console
            .line(&format!("  flexibility is {:.1} times as fast as from_scratch", self.speed_up));
    }
}

/// A line of the table of methods.
fn row(cells: [&str; 9]) -> String {
    let [method, half, all, cubature, linear, derivatives, reduction, fit, total] = cells;
    format!(
        "  {method:12} {half:>9} {all:>9} {cubature:>16} {linear:>9} {derivatives:>12} \
         {reduction:>10} {fit:>9} {total:>7}"
    )
}

fn hertz(frequency: Option<f64>) -> String {
    frequency.map_or("–".to_owned(), |hz| format!("{hz:.5}"))
}
