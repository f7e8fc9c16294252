//! The accuracy of rebuilt bases in Markdown.

use crate::accuracy::{Accuracies, LEADING};
use crate::loads::{DISPLACEMENT_RATIO, Kind, N_LOADS};
use crate::report::{self, Table};

fn percent(share: f64) -> String {
    format!("{:.3} %", 100.0 * share)
}

fn degrees(angle: f64) -> String {
    match angle.to_degrees() {
        a if a < 0.01 => format!("{a:.0e}°"),
        a if a < 10.0 => format!("{a:.2}°"),
        a => format!("{a:.0}°"),
    }
}

/// Everything.
pub(crate) fn markdown(results: &Accuracies, pictures: &[String]) -> String {
    let mut text =
        format!("# How good a rebuilt basis is\n\n{}\n", report::machine(&results.machine));
    text += &report::targets(&results.targets).note(
        "Eigenvalues: relative error of the worst; static errors: ours over theirs, medians over the \
         loads, every tet summed.",
    );
    text += &report::correctness(&results.checks).note(
        "A subspace's equilibrium has at least the potential energy of the true one, and Ritz values \
         lie above the eigenvalues.",
    );
    text += &statics(results);
    text += &modes(results);
    text += &loads(results);
    for picture in pictures {
        text += &format!("\n![{picture}]({picture})\n");
    }
    text
}

fn statics(results: &Accuracies) -> String {
    let mut table = Table::new(
        "Static solutions in the subspace against the full nonlinear body",
        &[
            "body",
            "loads",
            "basis",
            "columns",
            "median error",
            "over from scratch",
            "range",
            "by cubature",
            "cubature's held-out error",
        ],
    );
    for body in &results.bodies {
        for kind in Kind::ALL {
            let exact = body.qualities[0].static_error(kind);
            for quality in &body.qualities {
                let error = quality.static_error(kind);
                let of_kind = quality.statics.iter().filter(|statics| statics.kind == kind);
                let all: Vec<f64> = of_kind.flat_map(|s| s.exact.iter().copied()).collect();
                let least = all.iter().copied().fold(f64::INFINITY, f64::min);
                let most = all.iter().copied().fold(0.0, f64::max);
                table.row(&[
                    body.name.clone(),
                    kind.name().into(),
                    quality.way.name().into(),
                    quality.n_columns.to_string(),
                    percent(error),
                    format!("{:.2}", error / exact),
                    format!("{} – {}", percent(least), percent(most)),
                    quality.cubature_error(kind).map_or("–".into(), percent),
                    quality.cubature.as_ref().map_or("–".into(), |cubature| {
                        format!("{:.1} % ({})", 100.0 * cubature.held_out_error, cubature.source)
                    }),
                ]);
            }
        }
    }
    let [low, high] = DISPLACEMENT_RATIO.map(|ratio| 100.0 * ratio);
    table.note(&format!(
        "Error of the reduced static solution in the mass norm over the true one's, medians of \
         {N_LOADS} loads, each with a largest displacement between {low} and {high} % of the \
         body's longest side. Smooth: per unit of mass a random vector and a random linear function \
         of the place; pull: a random direction around a random vertex. “Original” is the basis from \
         before the stitches, held by them, with the rigid motions if the body is free. By cubature: the same solution \
         with the generation's own rule (100 % where that has none), beside that rule's force error on held-out poses."
    ))
}

fn modes(results: &Accuracies) -> String {
    let [ten, thirty] = LEADING.map(|count| format!("basis, leading {count}"));
    let mut table = Table::new(
        "Eigenvalues and principal angles against from scratch",
        &[
            "body",
            "stitches",
            "basis",
            "eigenvalues, lower half",
            "all",
            "angle, lower half",
            "all kept modes",
            &ten,
            &thirty,
            "basis, all",
        ],
    );
    for body in &results.bodies {
        for quality in &body.qualities[1..] {
            let [lower, all] = quality.worst_eigenvalue_errors();
            let mut cells = vec![
                body.name.clone(),
                format!("{} of {}", body.n_stitches, body.n_pairs),
                quality.way.name().into(),
                format!("{lower:.1e}"),
                format!("{all:.1e}"),
                degrees(quality.lower_half_angle),
                degrees(quality.modes_angle),
            ];
            cells.extend(quality.basis_angles.iter().map(|angle| degrees(*angle)));
            table.row(&cells);
        }
    }
    table.note(
        "Worst relative eigenvalue error; largest principal angle in the mass norm. Spans that end \
         within a cluster of eigenvalues differ by more than their modes do.",
    )
}

fn loads(results: &Accuracies) -> String {
    let mut table = Table::new(
        "Loads",
        &["body", "kind", "forces", "largest displacement", "off the linear response", "residual"],
    );
    for body in &results.bodies {
        for load in &body.loads {
            table.row(&[
                body.name.clone(),
                load.kind.name().into(),
                format!("{:.2e} N", load.force_n),
                percent(load.displacement_ratio),
                percent(load.nonlinearity),
                format!("{:.0e}", load.residual),
            ]);
        }
    }
    table.note("Forces: sum of their absolute values; residual: after the last Newton iteration.")
}
