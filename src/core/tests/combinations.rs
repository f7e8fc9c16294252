//! Bases as combinations of named columns.

use crate::bodies::{STITCH_N_M, bar, by, params, stitch};
use std::collections::BTreeMap;
use sutura_core::build::{self, Artifacts, BasisCombination, Method};
use sutura_core::control::Uncontrolled;
use sutura_core::edit::Edit;
use sutura_core::testing::Cut;

/// Columns by the name of their block.
type Held = BTreeMap<u64, Vec<Vec<f64>>>;

/// Adds the blocks of `body` that are not held yet; how many columns that took.
fn fetch(body: &Artifacts, combination: &BasisCombination, held: &mut Held) -> usize {
    let mut n_columns = 0;
    for block in &combination.blocks {
        held.entry(block.id).or_insert_with(|| {
            let columns: Vec<_> = body.block_columns(block.id).unwrap().collect();
            assert_eq!(columns.len(), block.n_columns);
            n_columns += columns.len();
            columns
        });
    }
    n_columns
}

/// The largest difference between D·W, both as `round` leaves them, and the basis, relative to the
/// basis's largest entry.
fn error(
    body: &Artifacts,
    combination: &BasisCombination,
    held: &Held,
    round: fn(f64) -> f64,
) -> f64 {
    let r = body.basis_size();
    let all: Vec<&Vec<f64>> =
        combination.blocks.iter().flat_map(|block| &held[&block.id]).collect();
    assert_eq!(combination.w.len(), combination.columns.len() * r);
    assert!(combination.columns.is_sorted_by(|a, b| a < b));
    let (mut error, mut largest) = (0.0f64, 0.0f64);
    for j in 0..r {
        let column = body.basis_column(j);
        let mut sum = vec![0.0f64; column.len()];
        for (&i, w) in combination.columns.iter().zip(combination.w.chunks(r)) {
            assert!(w.iter().any(|x| *x != 0.0), "a column that takes no part");
            sum.iter_mut().zip(all[i]).for_each(|(sum, x)| *sum += round(w[j]) * round(*x));
        }
        for (a, b) in column.iter().zip(&sum) {
            error = error.max((a - b).abs());
            largest = largest.max(a.abs());
        }
    }
    error / largest
}

#[test]
fn blocks_and_coefficients_are_the_basis_and_edits_in_a_seam_share_the_blocks() {
    let bar = bar(Cut::Through);
    let params = build::BuildParams { basis_size: 24, ..params(&bar, 12) };
    let open = build::build(bar.mesh.clone(), &params, &Uncontrolled).unwrap();
    let before = open.prepared_blocks();
    build::prepare_seams(&open, &bar.pairs, &Uncontrolled).unwrap();
    let prepared = open.prepared_blocks();
    assert!(before.len() < prepared.len());
    assert!(before.iter().all(|block| prepared.contains(block)), "columns are made once");

    let mut held = Held::new();
    let whole = open.basis_combination();
    assert_eq!(fetch(&open, &whole, &mut held), open.basis_size());
    assert_eq!(error(&open, &whole, &held, |x| x), 0.0);

    let next = |edits: &[Edit], method| {
        build::rebuild(&open, edits, &by(method), &Uncontrolled).unwrap().0
    };
    // All pairs use every prepared column; some leave those of others out.
    for (pairs, is_first) in [(&bar.pairs[..], true), (&bar.pairs[1..4], false)] {
        let edited = next(&stitch(pairs, STITCH_N_M), Method::Flexibility);
        let combination = edited.basis_combination();
        assert!(combination.blocks.iter().all(|block| prepared.contains(block)));
        let n_fetched = fetch(&edited, &combination, &mut held);
        assert_eq!(n_fetched > 0, is_first);
        let n_prepared: usize = prepared.iter().map(|block| block.n_columns).sum();
        let unused = n_prepared - combination.columns.len();
        assert!(unused >= 6 * (bar.pairs.len() - pairs.len()), "{unused} of {n_prepared}");
        let exact = error(&edited, &combination, &held, |x| x);
        assert!(exact < 1e-12, "{exact:e}");
        // About ten times what rounding the basis itself does.
        let single = error(&edited, &combination, &held, |x| x as f32 as f64);
        assert!(single < 5e-7, "{single:e}");
    }
    let scratch = next(&stitch(&bar.pairs, STITCH_N_M), Method::FromScratch);
    let combination = scratch.basis_combination();
    let [block] = combination.blocks[..] else { panic!("{:?}", combination.blocks) };
    assert!(!prepared.contains(&block));
    fetch(&scratch, &combination, &mut held);
    assert_eq!(error(&scratch, &combination, &held, |x| x), 0.0);
    assert!(open.block_columns(block.id).is_none(), "a block of another generation alone");
}
