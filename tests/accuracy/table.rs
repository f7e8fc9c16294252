//! Median errors of the ways to make a basis, held against `reference.json`.

use crate::bar::{Case, Load, Truth, median};
use crate::bases::{Derivatives, basis, modes};
use serde_json::{Value, json};
use std::fmt::Write as _;
use sutura_core::build::{self, Artifacts, BuildParams, Method, RebuildParams};
use sutura_core::control::Uncontrolled;

/// A median may differ by so much from the recorded one, either way: a basis that became better is
/// worth recording too.
const DRIFT: f64 = 0.25;

/// How much worse than from scratch a rebuilt basis may be.
const ACCEPTED: f64 = 1.5;

/// Name a file in this variable to record the table there.
const RECORD: &str = "SUTURA_RECORD_ACCURACY";

/// The ways to make a basis.
const WAYS: [&str; 6] = [
    "from_scratch",
    "flexibility",
    "low_rank",
    "not_rebuilt",
    "exact_modes_6_new_and_reused_derivatives",
    "exact_modes_8_new_derivatives",
];

fn rebuilt(before: &Artifacts, case: &Case, method: Method) -> Artifacts {
    let params = RebuildParams::new(method, 1e-4);
    build::rebuild(before, &case.edit, &params, &Uncontrolled).unwrap().0
}

/// Medians of one kind of load and one size of basis, in the order of [`WAYS`].
fn medians(case: &Case, truth: &Truth<'_>, basis_size: usize) -> [f64; WAYS.len()] {
    let params = BuildParams { basis_size, ..case.params.clone() };
    let before = case.build(&params);
    let [exact, flexibility, low_rank] =
        [Method::FromScratch, Method::Flexibility, Method::LowRank]
            .map(|method| rebuilt(&before, case, method));
    // The last two tell what the reuse of old derivatives costs when the modes are exact.
    let (new, old) = (modes(&exact), modes(&before));
    let six = Derivatives::new(&exact, &new, 6, 1.0);
    let eight = Derivatives::new(&exact, &new, 8, 1.0);
    let reused = Derivatives::new(&exact, &old, params.n_derivative_modes, 0.4);
    let hybrid = basis(truth.body.mass(), &new, &[&six, &reused], basis_size);
    let full = basis(truth.body.mass(), &new, &[&eight], basis_size);
    [
        exact.basis(),
        flexibility.basis(),
        low_rank.basis(),
        before.basis(),
        hybrid.as_ref(),
        full.as_ref(),
    ]
    .map(|basis| median(&truth.errors(basis)))
}

#[test]
fn a_rebuilt_basis_is_nearly_as_good_as_one_from_scratch() {
    let recorded: Value = serde_json::from_str(include_str!("reference.json")).unwrap();
    let case = Case::new();
    let stitched = rebuilt(&case.build(&case.params), &case, Method::FromScratch);
    let mut table = json!({});
    let mut failures = String::new();
    for kind in [Load::Smooth, Load::Pull] {
        let truth = Truth::new(&case, &stitched, kind);
        println!("{kind:?} loads, tip displacement over length {:.3?}", truth.tip_ratios);
        for basis_size in [40, 60] {
            let medians = medians(&case, &truth, basis_size);
            let load = format!("{kind:?}").to_lowercase();
            let name = format!("{load}_loads_{basis_size}_columns");
            for (way, median) in WAYS.into_iter().zip(medians) {
                println!("  {basis_size} columns  {way:42} {:9.4} %", 100.0 * median);
                table[&name][way] = json!(format!("{median:.3e}").parse::<f64>().unwrap());
                let expected = recorded[&name][way].as_f64().unwrap_or(f64::NAN);
                let drift = (median / expected - 1.0).abs();
                if drift.is_nan() || drift > DRIFT {
                    let _ =
                        writeln!(failures, "{name} {way}: {median:.3e}, recorded {expected:.3e}");
                }
            }
            let [exact, flexibility, low_rank, not_rebuilt, ..] = medians;
            if flexibility > ACCEPTED * exact {
                let _ = writeln!(failures, "{name}: flexibility {flexibility:e}, exact {exact:e}");
            }
            // What the rebuild is for: without it the body locks.
            if not_rebuilt < 10.0 * exact || low_rank < 2.0 * exact {
                let _ = writeln!(failures, "{name}: the case no longer tells the ways apart");
            }
        }
    }
    if let Ok(path) = std::env::var(RECORD) {
        std::fs::write(path, serde_json::to_string_pretty(&table).unwrap() + "\n").unwrap();
    }
    assert!(failures.is_empty(), "\n{failures}");
}
