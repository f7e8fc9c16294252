//! The results in Markdown.

use crate::cubature::{ERRORS, POINTS};
use crate::edits::{Comparison, Rebuilds};
use crate::measure::{Check, Machine, Times};
use crate::paper;
use crate::peers::{Ratio, Target};
use crate::results::Results;
use std::fmt::Write;

/// Seconds in the unit that suits them.
pub(crate) fn seconds(s: f64) -> String {
    match s {
        s if s >= 10.0 => format!("{s:.1} s"),
        s if s >= 0.1 => format!("{s:.2} s"),
        s if s >= 1e-2 => format!("{:.0} ms", 1e3 * s),
        s if s >= 1e-4 => format!("{:.1} ms", 1e3 * s),
        s if s >= 1e-7 => format!("{:.1} µs", 1e6 * s),
        s => format!("{:.1} ns", 1e9 * s),
    }
}

fn ratio(from: f64, to: f64) -> String {
    match from / to {
        r if r >= 99.5 => format!("{r:.0}×"),
        r => format!("{r:.1}×"),
    }
}

/// A ratio, or a residual.
fn number(value: f64) -> String {
    if value != 0.0 && value.abs() < 1e-2 { format!("{value:.1e}") } else { format!("{value:.2}") }
}

fn megabytes(bytes: f64) -> String {
    format!("{:.0} MB", bytes / 1e6)
}

/// A table being written.
pub(crate) struct Table(String);

impl Table {
    pub(crate) fn new(title: &str, head: &[&str]) -> Table {
        let mut table = Table(format!("\n## {title}\n\n"));
        table.row(&head.iter().map(|cell| (*cell).to_owned()).collect::<Vec<_>>());
        table.row(&vec!["---".to_owned(); head.len()]);
        table
    }

    pub(crate) fn row(&mut self, cells: &[String]) {
        self.0.push_str(&format!("| {} |\n", cells.join(" | ")));
    }

    pub(crate) fn note(mut self, text: &str) -> String {
        self.0.push_str(&format!("\n{text}\n"));
        self.0
    }
}

/// What the figures were measured on.
pub(crate) fn machine(machine: &Machine) -> String {
    format!(
        "{}, {} threads, {}, {:.0} GB; load average at the start {:.2}.",
        machine.cpu,
        machine.n_threads,
        machine.vectors.join(" "),
        machine.memory_bytes as f64 / 1e9,
        machine.load_average,
    )
}

/// Everything.
pub(crate) fn markdown(results: &Results, pictures: &[String]) -> String {
    let mut text = String::from("# What the numerical core takes\n\n");
    let _ = writeln!(
        text,
        "{} Medians of {} repetitions; `paper_table.json` has the shortest and the longest.",
        machine(&results.machine),
        results.repeat,
    );
    if let Some(peers) = &results.peers {
        let _ = writeln!(text, "\nPeers, in the same run: {}.", peers.description);
    }
    text += &targets(&results.ratios).note(
        "Ratios with a target of “at least” are theirs over ours, the others ours over theirs \
         (exponents: the \
         difference; residuals: ours).",
    );
    let mut notes = String::from("Shown and not judged:");
    for body in &results.bodies {
        for note in &body.edits.notes {
            let _ = write!(notes, " {}: {} {:.1e};", body.name, note.what, note.value);
        }
    }
    text += &correctness(&results.checks).note(notes.trim_end_matches(';'));
    text += &table_1a(results);
    text += &table_1b(results);
    text += &table_1c(results);
    text += &coverage(results);
    text += &speedup(results);
    text += &stages(results);
    text += &kernels(results);
    text += &cubature(results);
    text += &vega(results);
    text += &scaling(results);
    if !pictures.is_empty() {
        text.push_str("\n## Pictures\n\n");
        for picture in pictures {
            let _ = writeln!(text, "![{picture}]({picture})\n");
        }
    }
    text
}

/// Every comparison, and whether its target is met.
pub(crate) fn targets(ratios: &[Ratio]) -> Table {
    let head = ["work", "body", "against", "ours", "theirs", "ratio", "target", ""];
    let mut table = Table::new("Targets", &head);
    for ratio in ratios {
        let target = match ratio.target {
            // Residuals need an exponent.
            Target::AtMost(limit) if limit < 1e-3 => format!("≤ {limit:e}"),
            Target::AtMost(limit) => format!("≤ {limit}"),
            Target::AtLeast(limit) => format!("≥ {limit}"),
            Target::Within(limit) => format!("± {limit}"),
            Target::None => String::new(),
        };
        let verdict = match ratio.is_met() {
            Some(true) => "met",
            Some(false) => "**missed**",
            None => "",
        };
        table.row(&[
            ratio.work.clone(),
            ratio.body.clone(),
            ratio.against.clone(),
            ratio.ours.clone(),
            ratio.theirs.clone(),
            number(ratio.value),
            target,
            verdict.into(),
        ]);
    }
    table
}

/// The worst of every check.
pub(crate) fn correctness(checks: &[(String, Check)]) -> Table {
    let mut worst: Vec<(&str, &str, f64, f64, usize, bool)> = Vec::new();
    for (body, check) in checks {
        match worst.iter_mut().find(|(what, ..)| *what == check.what) {
            Some(entry) => {
                entry.4 += 1;
                entry.5 &= check.holds();
                if check.value > entry.2 || check.value.is_nan() {
                    (entry.1, entry.2, entry.3) = (body, check.value, check.limit);
                }
            }
            None => {
                worst.push((&check.what, body, check.value, check.limit, 1, check.holds()));
            }
        }
    }
    let mut table =
        Table::new("Correctness", &["check", "worst", "of", "limit", "checked", "right"]);
    for (what, body, value, limit, count, holds) in worst {
        table.row(&[
            what.into(),
            format!("{value:.1e}"),
            body.into(),
            format!("{limit:.0e}"),
            count.to_string(),
            if holds { "yes".into() } else { "**no**".into() },
        ]);
    }
    table
}

/// From scratch, ours unprepared and prepared, and the paper's three figures.
fn three(
    comparison: &Comparison,
    stage: fn(&Rebuilds) -> &Times,
    paper: Option<[f64; 2]>,
) -> Vec<String> {
    let [from, unprepared, prepared] =
        [&comparison.from_scratch, &comparison.unprepared, &comparison.prepared]
            .map(|rebuilds| stage(rebuilds).median_s);
    let mut cells = vec![
        seconds(from),
        seconds(unprepared),
        ratio(from, unprepared),
        seconds(prepared),
        ratio(from, prepared),
    ];
    cells.extend(papers(paper));
    cells
}

fn papers(figures: Option<[f64; 2]>) -> [String; 3] {
    match figures {
        None => ["–".into(), "–".into(), "–".into()],
        Some([from, to]) => [format!("{from:.2} s"), format!("{to:.2} s"), ratio(from, to)],
    }
}

fn table_1a(results: &Results) -> String {
    let mut table = Table::new(
        "Table 1 (a): linear modes after an edit",
        &[
            "body",
            "vertices",
            "tets",
            "stitches",
            "from scratch",
            "ours",
            "speed-up",
            "ours, prepared",
            "speed-up",
            "[M16] from scratch",
            "[M16]",
            "speed-up",
        ],
    );
    for body in &results.bodies {
        let row = paper::row_of(&body.name);
        let mut cells = vec![
            body.name.clone(),
            body.kernels.n_vertices.to_string(),
            body.kernels.n_tets.to_string(),
            body.edits.table.comparison.n_stitches.to_string(),
        ];
        let figures = row.map(|row| row.modes_s);
        cells.extend(three(&body.edits.table.comparison, |r| &r.modes, figures));
        table.row(&cells);
    }
    let sizes: Vec<String> = paper::TABLE_1
        .iter()
        .map(|row| {
            let [vertices, tets, springs] = row.size;
            format!("{} {vertices}K / {tets}K / {springs}", row.name)
        })
        .collect();
    table.note(&format!(
        "30 modes. From scratch: stiffness, factorization and eigensolver; ours: by flexibility to \
         1e-4 (see Correctness), prepared when the stitched pairs were named as seams before. [M16]: \
         Mukherjee, Wu, Wang 2016, Table 1, on a Core i7-3770S, whose update is not exact; its bodies \
         (vertices / tets / springs: {}) are not ours, which are of the same sizes.",
        sizes.join(", ")
    ))
}

fn table_1b(results: &Results) -> String {
    let mut table = Table::new(
        "Table 1 (b): modal derivatives after an edit",
        &[
            "body",
            "derivatives",
            "from scratch",
            "ours",
            "speed-up",
            "ours, prepared",
            "speed-up",
            "[M16] derivatives",
            "[M16] from scratch",
            "[M16]",
            "speed-up",
        ],
    );
    for body in &results.bodies {
        let row = paper::row_of(&body.name);
        let mut cells = vec![body.name.clone(), body.edits.table.n_derivatives.to_string()];
        let figures = row.map(|row| row.derivatives_s);
        let mut times = three(&body.edits.table.comparison, |r| &r.derivatives, figures);
        times.insert(5, row.map_or("–".into(), |row| row.n_derivatives.to_string()));
        cells.extend(times);
        table.row(&cells);
    }
    table.note(
        "Ours: all of them anew, by the base body's factorization (the paper takes 21 anew and 40 % of \
         the right-hand sides of the body before the edit); prepared: the right-hand sides of the open \
         and of the closed body, twice as many, without a solve.",
    )
}

fn table_1c(results: &Results) -> String {
    let mut table = Table::new(
        "Table 1 (c): final PCA",
        &[
            "body",
            "columns",
            "standard SVD",
            "ours",
            "speed-up",
            "[M16] standard",
            "[M16] randomized",
            "speed-up",
        ],
    );
    for body in &results.bodies {
        let pca = &body.kernels.pca;
        let mut cells = vec![
            body.name.clone(),
            pca.n_columns.to_string(),
            seconds(pca.standard.median_s),
            seconds(pca.ours.median_s),
            ratio(pca.standard.median_s, pca.ours.median_s),
        ];
        cells.extend(papers(paper::row_of(&body.name).map(|row| row.pca_s)));
        table.row(&cells);
    }
    table.note("Standard: thin singular value decomposition (faer, one thread) of the weighed n × k matrix.")
}

fn coverage(results: &Results) -> String {
    let mut table = Table::new(
        "Figure 3: coverage of the exact modes of the stitched body",
        &["body", "by", "vectors", "modes 1–5, worst", "modes 1–10, worst", "modes 1–30, worst"],
    );
    for body in &results.bodies {
        for curve in &body.edits.coverage {
            let worst = |count: usize| {
                let share = curve.share.iter().take(count).copied().fold(1.0, f64::min);
                // Near one, the digits are in what is missing.
                if share > 0.999 {
                    format!("1 − {:.0e}", 1.0 - share)
                } else {
                    format!("{share:.3}")
                }
            };
            table.row(&[
                body.name.clone(),
                curve.by.clone(),
                curve.n_vectors.to_string(),
                worst(5),
                worst(10),
                worst(30),
            ]);
        }
    }
    table.note(
        "Mass norm of each exact mode's projection on the vectors; “original” is not rebuilt.",
    )
}

fn speedup(results: &Results) -> String {
    let mut table = Table::new(
        "Figure 5: speed-up against the number of stitches",
        &[
            "body",
            "stitches",
            "modes from scratch",
            "ours",
            "prepared",
            "edit from scratch",
            "ours",
            "speed-up",
            "rule reused",
            "speed-up",
            "prepared",
            "speed-up",
            "first answer",
            "speed-up",
        ],
    );
    for body in &results.bodies {
        for point in &body.edits.speedup {
            let [from, plain, prepared] = [&point.from_scratch, &point.unprepared, &point.prepared];
            let first = &point.first_answer;
            let modes_from = from.modes.median_s;
            table.row(&[
                body.name.clone(),
                point.n_stitches.to_string(),
                seconds(modes_from),
                ratio(modes_from, plain.modes.median_s),
                ratio(modes_from, prepared.modes.median_s),
                seconds(from.total.median_s),
                seconds(plain.total.median_s),
                ratio(from.total.median_s, plain.total.median_s),
                seconds(point.reusing.total.median_s),
                ratio(from.total.median_s, point.reusing.total.median_s),
                seconds(prepared.total.median_s),
                ratio(from.total.median_s, prepared.total.median_s),
                seconds(first.total.median_s),
                ratio(from.total.median_s, first.total.median_s),
            ]);
        }
    }
    table.note(
        "A session's settings: 30 modes, 36 derivatives, 60 columns, 120 cubature points. Where the \
         cubature rule has become too inaccurate, it is fitted again or anew; “rule reused” is ours \
         with it reused and its error reported, the first answer, which a deadline asks for, the same prepared.",
    )
}

fn stages(results: &Results) -> String {
    let mut names: Vec<&str> = Vec::new();
    for (name, _) in results.bodies.iter().flat_map(|body| &body.sessions.stages) {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    let mut head = vec!["body", "build"];
    head.extend(&names);
    head.extend(["peak memory", "factor", "ratio", "kept", "cubature error"]);
    let mut table = Table::new("A session build by stages", &head);
    for body in &results.bodies {
        let sessions = &body.sessions;
        let last = &sessions.last;
        let mut cells = vec![body.name.clone(), seconds(sessions.total.median_s)];
        for name in &names {
            let found = sessions.stages.iter().find(|(other, _)| other == name);
            cells.push(found.map_or("–".into(), |(_, times)| seconds(times.median_s)));
        }
        let peak = sessions.peak_memory_bytes;
        let factor = last.factor_bytes as f64;
        cells.extend([
            peak.map_or("–".into(), megabytes),
            megabytes(factor),
            peak.map_or("–".into(), |peak| format!("{:.1}", peak / factor)),
            megabytes(last.kept_bytes as f64),
            match (last.cubature_error, last.n_cubature_points) {
                (Some(error), Some(n)) => format!("{:.1} % ({n} points)", 100.0 * error),
                _ => "–".into(),
            },
        ]);
        table.row(&cells);
    }
    table.note(
        "Each build in a process of its own, the mesh already read; peak memory is the process's.",
    )
}

fn kernels(results: &Results) -> String {
    let mut table = Table::new(
        "Stage by stage",
        &[
            "body",
            "free dofs",
            "assembly",
            "ordering and analysis",
            "numbers",
            "GFLOP/s",
            "1 column",
            "8",
            "32",
            "modes",
            "right-hand sides of 36 pairs",
            "of 210",
            "per tet and pair",
        ],
    );
    for body in &results.bodies {
        let kernels = &body.kernels;
        let mut cells = vec![
            body.name.clone(),
            kernels.n_free_dofs.to_string(),
            seconds(kernels.assembly.median_s),
            seconds(kernels.analysis.median_s),
            seconds(kernels.numeric.median_s),
            format!("{:.0}", 1e-9 * kernels.factor_flops / kernels.numeric.median_s),
        ];
        cells.extend(kernels.solves.iter().map(|solve| seconds(solve.times.median_s)));
        cells.push(seconds(kernels.modes.median_s));
        cells.extend(kernels.loads.iter().map(|loads| seconds(loads.times.median_s)));
        let last = kernels.loads.last();
        cells.push(last.map_or("–".into(), |loads| {
            seconds(loads.times.median_s / (loads.n_pairs * kernels.n_tets) as f64)
        }));
        table.row(&cells);
    }
    table.note("36 modes; rigid ones come on top.")
}

fn cubature(results: &Results) -> String {
    if results.bodies.iter().all(|body| body.cubature.is_empty()) {
        return String::new();
    }
    let mut head = vec!["body".to_owned(), "method".to_owned()];
    head.extend(POINTS.map(|points| format!("{points} points")));
    head.extend(ERRORS.map(|error| format!("points for {} %", 100.0 * error)));
    let head: Vec<&str> = head.iter().map(String::as_str).collect();
    let mut table = Table::new("Cubature: methods of selection", &head);
    for body in &results.bodies {
        for method in &body.cubature {
            let mut cells = vec![body.name.clone(), method.name.clone()];
            cells.extend(method.trainings.iter().map(|training| {
                format!("{:.1} %, {}", 100.0 * training.error, seconds(training.seconds))
            }));
            cells.extend(ERRORS.map(|error| {
                method.points_at(error).map_or("–".into(), |points| format!("{points:.0}"))
            }));
            table.row(&cells);
        }
    }
    table.note(
        "Force error on held-out poses in the energy norm, 60 columns, 100 training poses; seconds of \
         exact forces, selection and fit; points interpolated.",
    )
}

fn vega(results: &Results) -> String {
    let Some(vega) = &results.vega else { return String::new() };
    let mut table = Table::new("VegaFEM's settings", &["stage", "ours"]);
    for (name, times) in &vega.sessions.stages {
        table.row(&[name.clone(), seconds(times.median_s)]);
    }
    table.row(&["**all but reduction**".into(), seconds(vega.build_s())]);
    table.note(&format!(
        "{} with its pairs welded: 20 modes of the consistent mass, all 210 derivatives, 30 columns \
         from those 230, no cubature; the reduction tables stand where VegaFEM has its polynomials, \
         which are left out of both. VegaFEM took {:.1} s where its factorization by Pardiso took \
         {} s.",
        results.vega_body,
        paper::vega::BUILD_S,
        paper::vega::FACTORIZATION_S,
    ))
}

fn scaling(results: &Results) -> String {
    let Some(scaling) = &results.scaling else { return String::new() };
    let mut table = Table::new(
        "Cost against size: cubes",
        &[
            "vertices",
            "free dofs",
            "factor",
            "GFLOP",
            "ordering and analysis",
            "numbers",
            "processor",
            "1 column",
            "32 columns",
        ],
    );
    for point in &scaling.points {
        table.row(&[
            point.n_vertices.to_string(),
            point.n_free_dofs.to_string(),
            megabytes(point.factor_bytes as f64),
            format!("{:.1}", 1e-9 * point.factor_flops),
            seconds(point.analysis.median_s),
            seconds(point.numeric.median_s),
            point.numeric.cpu_s.map_or("–".into(), seconds),
            seconds(point.solve_1.median_s),
            seconds(point.solve_32.median_s),
        ]);
    }
    let mut note = String::from("Exponents fitted to the largest sizes, by least squares:");
    for exponent in &scaling.exponents {
        let _ = write!(
            note,
            " {} {:.2} (theory {:.2});",
            exponent.what, exponent.fitted, exponent.theory
        );
    }
    table.note(note.trim_end_matches(';'))
}
