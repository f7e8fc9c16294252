//! Static equilibrium of the full-order nonlinear body: the truth that a basis is judged by.

use crate::assembly::FullModel;
use crate::assembly::mass::Mass;
use crate::build::RayleighDamping;
use crate::cubature::Rule;
use crate::dictionary::Combination;
use crate::edit::Stitch;
use crate::factorization::{SparseCholesky, shifted};
use crate::modes::stitched::StitchMatrix;
use crate::reduced::ReducedModel;
use faer::{Mat, MatRef};
use std::sync::Arc;

/// Equal steps in which the load is applied.
const LOAD_STEPS: usize = 4;

/// Newton iterations for one load step.
const MOST_ITERATIONS: usize = 60;

/// Residual relative to the load at which a step is solved.
const TOLERANCE: f64 = 1e-10;

/// u with f_int(u) + AAᵀu = `load` (free degrees of freedom, N), by Newton's method with a line
/// search on the potential and the load applied in steps; or why there is none.
pub fn solve_full_static(
    model: &FullModel,
    stitches: &[Stitch],
    load: &[f64],
) -> Result<Vec<f64>, String> {
    let pairs: Vec<[u32; 2]> = stitches.iter().map(|s| s.pair).collect();
    let pattern = Arc::new(model.pattern(&pairs));
    let a = StitchMatrix::new(model, stitches);
    let masses = model.lumped_mass_kg();
    let mass = Mass::Lumped(model.free_vertices().iter().map(|&v| masses[v as usize]).collect());
    let norm = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>().sqrt();
    let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    let stretch = |u: &[f64]| a.transpose_times(column(u));
    let energy = |u: &[f64]| model.energy(u) + 0.5 * stretch(u).squared_norm_l2();
    let force = |u: &[f64]| -> Vec<f64> {
        let mut f = Mat::from_fn(u.len(), 1, |_, _| 0.0);
        a.add_times(&mut f, stretch(u).as_ref());
        model.internal_force(u).iter().zip(f.col_as_slice(0)).map(|(i, s)| i + s).collect()
    };

    let mut u = vec![0.0; model.n()];
    for step in 1..=LOAD_STEPS {
        let share = step as f64 / LOAD_STEPS as f64;
        let target: Vec<f64> = load.iter().map(|f| share * f).collect();
        let potential = |u: &[f64]| energy(u) - dot(u, &target);
        let mut solved = false;
        let mut residual = f64::INFINITY;
        for _ in 0..MOST_ITERATIONS {
            let gap: Vec<f64> = target.iter().zip(force(&u)).map(|(t, f)| t - f).collect();
            residual = norm(&gap) / norm(&target);
            if residual <= TOLERANCE {
                solved = true;
                break;
            }
            let mut tangent = model.tangent_stiffness(&u, &pattern);
            a.add_to(&mut tangent);
            // An indefinite tangent is shifted until it descends.
            let factor = [0.0, 1e2, 1e4, 1e6]
                .iter()
                .find_map(|sigma| SparseCholesky::of_blocks(&shifted(&tangent, *sigma, &mass)).ok())
                .ok_or("the tangent stiffness could not be factorized")?;
            let mut direction = Mat::from_fn(gap.len(), 1, |i, _| gap[i]);
            factor.solve_in_place(direction.as_mut());
            let direction = direction.col_as_slice(0);
            let slope = dot(direction, &gap);
            let now = potential(&u);
            let rounding = 1e-13 * energy(&u).abs();
            let mut length = 1.0;
            u = loop {
                let trial: Vec<f64> =
                    u.iter().zip(direction).map(|(u, d)| u + length * d).collect();
                if potential(&trial) <= now - 1e-4 * length * slope + rounding {
                    break trial;
                }
                length *= 0.5;
                if length < 1e-9 {
                    return Err(format!("the line search failed at a residual of {residual:e}"));
                }
            };
        }
        if !solved {
            return Err(format!("load step {step} stopped at a residual of {residual:e}"));
        }
    }
    Ok(u)
}

/// The reduced model of a stitched body in any basis (n×r, M-orthonormal), summed over every tet.
pub fn exact_reduced_model(
    model: &FullModel,
    stitches: &[Stitch],
    basis: MatRef<'_, f64>,
) -> ReducedModel {
    let damping = RayleighDamping { mass_per_s: 0.0, stiffness_s: 0.0 };
    let rule = Rule::exact(model.corners().len());
    let stretch = StitchMatrix::new(model, stitches).transpose_times(basis);
    let basis = Combination::of_dense(basis.to_owned());
    ReducedModel::new(model, &rule, &basis, stretch.as_ref(), damping, 0)
}

fn column(x: &[f64]) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(x, x.len(), 1)
}
