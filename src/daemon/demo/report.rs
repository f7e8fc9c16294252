//! The report: what was measured, for people and as JSON.

use super::MAX_JUMP;
use super::case::Case;
use super::console::Console;
use super::error::DemoError;
use super::motion::Motion;
use super::rounds::RoundReport;
use serde::Serialize;
use std::path::{Path, PathBuf};
use sutura_client::proto::session::SessionInfo;
use sutura_core::control::Stage;

/// Everything that one run measured.
#[derive(Serialize)]
pub(crate) struct Report {
    pub(crate) case: CaseReport,
    pub(crate) build: BuildReport,
    pub(crate) rounds: Vec<RoundReport>,
    pub(crate) motion: Motion,
    pub(crate) pictures: Vec<PathBuf>,
}

/// What was worked on.
#[derive(Serialize)]
pub(crate) struct CaseReport {
    name: String,
    source: String,
    mesh_file: String,
    n_stitches: usize,
    stitch_stiffness_n_m: f64,
}

impl CaseReport {
    pub(crate) fn of(case: &Case) -> CaseReport {
        CaseReport {
            name: case.name.clone(),
            source: case.source.clone(),
            mesh_file: case.file_name.clone(),
            n_stitches: case.stitches.len(),
            stitch_stiffness_n_m: case.stitch_stiffness_n_m,
        }
    }
}

/// The session's first generation.
#[derive(Serialize)]
pub(crate) struct BuildReport {
    /// From the upload to readiness, in ms.
    pub(crate) wall_ms: f64,
    pub(crate) session: SessionInfo,
}

impl BuildReport {
    pub(crate) fn print(&self, console: Console) {
        let info = &self.session;
        let cubature = info
            .n_cubature_points
            .map_or("every tet".to_owned(), |n| format!("{n} cubature points"));
        console.line(&format!(
            "  ready in {:.2} s: {} free dofs, {} elastic and {} rigid modes, basis of {}, {cubature}",
            1e-3 * self.wall_ms,
            info.n_free_dofs,
            info.n_modes,
            info.n_rigid_modes,
            info.basis_size
        ));
        let time = |stage: Stage| info.timings_ms.get(stage.name()).map(|ms| (stage.name(), ms));
        let stages = Stage::ALL.into_iter().filter_map(time);
        let stages = stages.map(|(name, ms)| format!("{name} {ms:.0}"));
        console.line(&format!("  ms: {}", stages.collect::<Vec<_>>().join(", ")));
        for warning in &info.warnings {
            console.line(&format!("  note: {warning}"));
        }
    }
}

impl Report {
    /// Writes `report.json` and returns its path.
    pub(crate) fn write(&self, folder: &Path) -> Result<PathBuf, DemoError> {
        let path = folder.join("report.json");
        let json = serde_json::to_vec_pretty(self).map_err(std::io::Error::other);
        json.and_then(|json| std::fs::write(&path, json))
            .map_err(DemoError::system(format!("writing {}", path.display())))?;
        Ok(path)
    }

    /// Prints the same JSON on standard output.
    pub(crate) fn print(&self) {
        if let Ok(json) = serde_json::to_string_pretty(self) {
            println!("{json}");
        }
    }

    /// Refuses a run in which the body was seen to jump. A watcher that is too slow loses states, and what it has
    /// left to go by is an estimate over a gap.
    pub(crate) fn check(&self) -> Result<(), DemoError> {
        let switch = &self.motion.seen.switch;
        let jump = switch.jump;
        // Not a number is a failure too.
        if jump <= MAX_JUMP || !switch.is_seen() {
            return Ok(());
        }
        Err(DemoError::Unexpected(format!(
            "the edit in mid-motion moved the body by {:.2} % of its displacement, at most {:.0} % is \
             allowed",
            100.0 * jump,
            100.0 * MAX_JUMP
        )))
    }
}

/// Prints what the watching process saw.
pub(crate) fn print_motion(console: Console, motion: &Motion) {
    let seen = &motion.seen;
    console.line(&format!(
        "  closed body, over Zenoh in another process: {} states in {:.2} s simulated ({} lost), up \
         to {:.2} mm",
        seen.n_frames,
        seen.duration_s,
        seen.n_lost,
        1e3 * seen.furthest.max_displacement_m
    ));
    let switch = &seen.switch;
    console.line(&format!(
        "  generation {} → {} at {:.3} s: the displacement field changed by {:.3} % of its {:.2} mm \
         ({})",
        switch.from_generation,
        switch.to_generation,
        switch.times_s[1],
        100.0 * switch.jump,
        1e3 * switch.max_displacement_m,
        match switch.is_seen() {
            true => format!("at most {:.0} %", 100.0 * MAX_JUMP),
            false => "an estimate: states of that moment were lost on the way".to_owned(),
        }
    ));
    console.line(&format!(
        "  {} steps, {} late, {} recovered",
        motion.simulation.n_steps, motion.simulation.n_late, motion.simulation.n_recovered
    ));
}
