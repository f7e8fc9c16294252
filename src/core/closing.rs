//! Guided closing: pairs of vertices that do not coincide are pulled together quasi-statically.
//!
//! The full-order body with its nonlinear material is brought into static equilibrium under zero-length
//! springs between the vertices of each pair, level by level with growing stiffness k. The force of a
//! pair is λ + k g with g its gap, and after each level λ takes over the force that the springs have
//! come to (the method of multipliers: Hestenes, *J. Optim. Theory Appl.* 4, 1969; Nocedal and Wright,
//! *Numerical Optimization*, §17.3). So gaps shrink at each level by about the ratio of the body's
//! stiffness to k and vanish at a stiffness that conditions no matrix badly; with springs alone, k
//! would have to grow as much as the gaps are to shrink.
//!
//! Each equilibrium is found by Newton's method with the exact tangent and a line search on the
//! potential, in which no tet may be pressed below [`LEAST_VOLUME_RATIO`]. A level that fails is tried
//! again with softer springs, that is with a smaller load; where that fails too, the last equilibrium
//! stands with the gaps that it has.

use crate::assembly::FullModel;
use crate::assembly::mass::{Mass, MassKind};
use crate::assembly::sparse::{BlockMatrix, Pattern};
use crate::control::{self, Cancelled, Control, Stage};
use crate::edit::Stitch;
use crate::factorization::{FactorizationError, SparseCholesky, SymbolicCholesky, shifted};
use crate::linalg::DenseError;
use crate::modes::rigid;
use crate::modes::stitched::StitchMatrix;
use faer::{Mat, MatRef};
use rayon::prelude::*;
use std::sync::Arc;

/// No tet is pressed below this fraction of its rest volume: long before, the stress of St.
/// Venant–Kirchhoff in compression falls instead of rising.
pub const LEAST_VOLUME_RATIO: f64 = 0.05;

/// Stiffness of the first level's springs, and of the stiffest, in units of the body's stiffness at
/// one of the vertices (mean over the pairs): a hundredth moves the vertices of a compliant body
/// without tearing at them; a thousand times as stiff, K̂ is still far from ill-conditioned.
const FIRST_STIFFNESS: f64 = 1e-2;
const LAST_STIFFNESS: f64 = 1e3;

/// Growth of the stiffness from a level to the next, and its reduction where a level fails.
const GROWTH: f64 = 10.0;
const REDUCTION: f64 = 8.0;

/// Levels tried, failed ones included.
const MOST_LEVELS: usize = 32;
/// Failures in a row after which the last equilibrium stands.
const MOST_FAILURES: usize = 6;
/// Levels without the gap falling by [`LEAST_PROGRESS`] after which it will not: pairs that supports or
/// the material keep apart.
const MOST_IDLE_LEVELS: usize = 4;
const LEAST_PROGRESS: f64 = 0.9;

/// Newton iterations for one level.
const MOST_ITERATIONS: usize = 40;

/// Residual relative to the pulling force at which a level is in equilibrium.
const TOLERANCE: f64 = 1e-9;

/// Shift of the tangent for bodies that the springs leave free, relative to the first elastic
/// eigenvalue: forces have no component along rigid motions, and along the others the shift costs this
/// factor an iteration.
const RELATIVE_SHIFT: f64 = 1e-3;

/// Shifts tried on a tangent that is indefinite, relative to the first elastic eigenvalue.
const DESCENT_SHIFTS: [f64; 5] = [1.0, 1e1, 1e2, 1e4, 1e6];

/// What is to be pulled together.
pub struct Closing<'a> {
    /// The body at rest.
    pub model: &'a FullModel,
    /// The pairs to close, and those of the stitches in force: they stay closed.
    pub pairs: &'a [[u32; 2]],
    /// A pair is closed when its gap is no wider, in m.
    pub closed_m: f64,
    /// An estimate of the first elastic eigenvalue, in 1/s²: the scale of shifts.
    pub eigenvalue_per_s2: f64,
}

/// One equilibrium on the way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Stiffness of the springs in N/m.
    pub stiffness_n_m: f64,
    /// The widest gap in m.
    pub gap_m: f64,
    /// ‖f_int + f_springs‖ over ‖f_springs‖ (or over the force of the first pull, where the springs
    /// come to rest).
    pub residual: f64,
}

/// The body as it was pulled together.
#[derive(Clone, Debug, PartialEq)]
pub struct Closed {
    /// Displacement of the free degrees of freedom in m.
    pub displacement_m: Vec<f64>,
    /// The gap left between the vertices of each pair in m.
    pub gaps_m: Vec<f64>,
    /// The equilibria, in order; empty if all pairs coincided from the start.
    pub levels: Vec<Level>,
    /// Why it went no further, if gaps are left.
    pub obstacle: Option<Obstacle>,
}

/// Why pairs could be pulled no nearer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)] // the messages say what they are
pub enum Obstacle {
    #[error("stiffer springs bring them no nearer")]
    Idle,
    #[error("tet {tet} would be crushed")]
    Crushed { tet: usize },
    #[error("no equilibrium was found beyond this")]
    NoEquilibrium,
}

/// Why a closing could not even begin.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // the messages say what the fields are
pub enum ClosingError {
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    #[error(transparent)]
    Dense(#[from] DenseError),
    #[error(transparent)]
    Factorization(#[from] FactorizationError),
}

/// Pulls the pairs together until all gaps are closed or something is in the way.
pub fn close(closing: &Closing<'_>, control: &dyn Control) -> Result<Closed, ClosingError> {
    let springs = Springs::new(closing);
    let n = closing.model.n();
    let mut state = State { u: vec![0.0; n], multipliers: springs.none() };
    let first_gap = springs.widest(&state.u);
    let closed = |state: &State, levels, obstacle| springs.closed(state, levels, obstacle);
    if first_gap <= closing.closed_m {
        return Ok(closed(&state, Vec::new(), None));
    }
    let newton = Newton::new(closing, &springs)?;
    let [first, last] = [FIRST_STIFFNESS, LAST_STIFFNESS].map(|k| k * newton.vertex_stiffness);
    let first_pull = first * norm(&springs.gaps(&state.u));
    let mut stiffness = first;
    let mut levels: Vec<Level> = Vec::new();
    let (mut n_failures, mut n_idle) = (0, 0);
    let mut obstacle = Obstacle::NoEquilibrium;
    for _ in 0..MOST_LEVELS {
        let before = levels.last().map_or(first_gap, |level| level.gap_m);
        match newton.equilibrium(&state, stiffness, first_pull, control)? {
            Ok((u, residual)) => {
                state.take_over(&springs, u, stiffness);
                let gap_m = springs.widest(&state.u);
                levels.push(Level { stiffness_n_m: stiffness, gap_m, residual });
                let done = (first_gap / gap_m.max(closing.closed_m)).ln()
                    / (first_gap / closing.closed_m).ln();
                control.progress(Stage::Closing, done.clamp(0.0, 1.0));
                if gap_m <= closing.closed_m {
                    return Ok(closed(&state, levels, None));
                }
                n_idle = if gap_m > LEAST_PROGRESS * before { n_idle + 1 } else { 0 };
                if n_idle == MOST_IDLE_LEVELS && stiffness == last {
                    obstacle = Obstacle::Idle;
                    break;
                }
                n_failures = 0;
                stiffness = (GROWTH * stiffness).min(last);
            }
            Err(met) => {
                obstacle = met;
                n_failures += 1;
                if n_failures == MOST_FAILURES {
                    break;
                }
                stiffness /= REDUCTION;
            }
        }
    }
    Ok(closed(&state, levels, Some(obstacle)))
}

/// An equilibrium, and the forces of the pairs there.
struct State {
    u: Vec<f64>,
    multipliers: Vec<f64>,
}

impl State {
    fn take_over(&mut self, springs: &Springs, u: Vec<f64>, stiffness: f64) {
        self.u = u;
        let gaps = springs.gaps(&self.u);
        for (multiplier, gap) in self.multipliers.iter_mut().zip(gaps) {
            *multiplier += stiffness * gap;
        }
    }
}

/// The springs of the pairs, per unit of stiffness.
struct Springs {
    stitches: Vec<Stitch>,
    a: StitchMatrix,
    /// Gaps at rest.
    rest_gaps: Vec<f64>,
}

impl Springs {
    fn new(closing: &Closing<'_>) -> Springs {
        // The matrix goes by ascending ends.
        let pairs = closing.pairs.iter().map(|&[a, b]| [a.min(b), a.max(b)]);
        let stitches: Vec<Stitch> =
            pairs.map(|pair| Stitch { id: 0, pair, stiffness_n_m: 1.0 }).collect();
        let a = StitchMatrix::new(closing.model, &stitches);
        let x = closing.model.mesh().vertices();
        let gap = |pair: [u32; 2]| {
            let [a, b] = pair.map(|v| x[v as usize]);
            [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
        };
        let rest_gaps = stitches.iter().flat_map(|stitch| gap(stitch.pair)).collect();
        Springs { stitches, a, rest_gaps }
    }

    fn none(&self) -> Vec<f64> {
        vec![0.0; self.rest_gaps.len()]
    }

    /// Gap vectors at `u`, three numbers a pair.
    fn gaps(&self, u: &[f64]) -> Vec<f64> {
        let moved = self.a.gaps(column(u));
        self.rest_gaps.iter().zip(moved.col_as_slice(0)).map(|(rest, moved)| rest + moved).collect()
    }

    fn widest(&self, u: &[f64]) -> f64 {
        self.gaps(u).chunks_exact(3).map(norm).fold(0.0, f64::max)
    }

    fn closed(&self, state: &State, levels: Vec<Level>, obstacle: Option<Obstacle>) -> Closed {
        Closed {
            displacement_m: state.u.clone(),
            gaps_m: self.gaps(&state.u).chunks_exact(3).map(norm).collect(),
            levels,
            obstacle,
        }
    }

    /// What springs of `stiffness` add to a tangent.
    fn of_stiffness(&self, model: &FullModel, stiffness: f64) -> StitchMatrix {
        let stitches: Vec<Stitch> = self
            .stitches
            .iter()
            .map(|stitch| Stitch { stiffness_n_m: stiffness, ..*stitch })
            .collect();
        StitchMatrix::new(model, &stitches)
    }
}

/// Newton's method for the equilibria.
struct Newton<'a> {
    model: &'a FullModel,
    springs: &'a Springs,
    pattern: Arc<Pattern>,
    symbolic: Arc<SymbolicCholesky>,
    /// Lumped, for shifts.
    mass: Mass,
    /// Shifts to try, in 1/s², ascending.
    shifts: Vec<f64>,
    /// Stiffness of the body at one vertex, mean over the pairs' ends, in N/m.
    vertex_stiffness: f64,
    diagonal_m: f64,
}

/// An equilibrium with its residual, or what was in the way.
type Found = Result<(Vec<f64>, f64), Obstacle>;

impl<'a> Newton<'a> {
    fn new(closing: &Closing<'a>, springs: &'a Springs) -> Result<Newton<'a>, ClosingError> {
        let model = closing.model;
        let pattern = Arc::new(model.pattern(closing.pairs));
        let symbolic = Arc::new(SymbolicCholesky::new(pattern.clone(), 3)?);
        let mass = model.mass(MassKind::Lumped, &pattern);
        let motions = rigid::rigid_modes(model, &mass)?;
        let left = rigid::unstretched(springs.a.gaps(motions.as_ref()).as_ref())?;
        let least = if left.ncols() == 0 { 0.0 } else { RELATIVE_SHIFT };
        let shifts = std::iter::once(least).chain(DESCENT_SHIFTS);
        let ends = closing.pairs.iter().flatten().filter_map(|&v| model.free_index(v));
        Ok(Newton {
            vertex_stiffness: mean_stiffness(&model.rest_stiffness(&pattern), ends),
            shifts: shifts.map(|shift| shift * closing.eigenvalue_per_s2).collect(),
            diagonal_m: model.mesh().diagonal(),
            model,
            springs,
            pattern,
            symbolic,
            mass,
        })
    }

    /// The equilibrium under the multipliers of `start` and springs of `stiffness`, from `start`.
    fn equilibrium(
        &self,
        start: &State,
        stiffness: f64,
        first_pull: f64,
        control: &dyn Control,
    ) -> Result<Found, ClosingError> {
        let multipliers = &start.multipliers[..];
        let stiff = self.springs.of_stiffness(self.model, stiffness);
        let mut u = start.u.clone();
        let rounding = self.force_rounding(stiffness);
        for _ in 0..MOST_ITERATIONS {
            control::check(control)?;
            let pull = self.spring_force(&u, multipliers, stiffness);
            let force: Vec<f64> =
                self.model.internal_force(&u).iter().zip(&pull).map(|(f, p)| f + p).collect();
            let scale = norm(&pull).max(first_pull);
            let imbalance = norm(&force);
            if !imbalance.is_finite() {
                return Ok(Err(Obstacle::NoEquilibrium));
            }
            if imbalance <= (TOLERANCE * scale).max(rounding) {
                return Ok(Ok((u, imbalance / scale)));
            }
            let Some(direction) = self.direction(&u, &stiff, &force) else {
                return Ok(Err(Obstacle::NoEquilibrium));
            };
            match self.search(&u, &direction, &force, multipliers, stiffness) {
                Ok(next) => u = next,
                Err(obstacle) => return Ok(Err(obstacle)),
            }
        }
        Ok(Err(Obstacle::NoEquilibrium))
    }

    /// −K̂⁻¹ of the force, with the least shift that makes the tangent positive definite.
    fn direction(&self, u: &[f64], stiff: &StitchMatrix, force: &[f64]) -> Option<Vec<f64>> {
        let mut tangent = self.model.tangent_stiffness(u, &self.pattern);
        stiff.add_to(&mut tangent);
        let factorize = |matrix: &BlockMatrix| {
            SparseCholesky::with_symbolic(self.symbolic.clone(), matrix).ok()
        };
        let factor = self.shifts.iter().find_map(|&shift| match shift {
            0.0 => factorize(&tangent),
            _ => factorize(&shifted(&tangent, shift, &self.mass)),
        })?;
        let mut direction = Mat::from_fn(force.len(), 1, |i, _| -force[i]);
        factor.solve_in_place(direction.as_mut());
        let direction = direction.col_as_slice(0).to_vec();
        direction.iter().all(|x| x.is_finite()).then_some(direction)
    }

    /// A point along `direction` where the potential has fallen and no tet is crushed.
    fn search(
        &self,
        u: &[f64],
        direction: &[f64],
        force: &[f64],
        multipliers: &[f64],
        stiffness: f64,
    ) -> Result<Vec<f64>, Obstacle> {
        let slope = dot(direction, force);
        let [now, terms] = self.potential(u, multipliers, stiffness);
        let rounding = 1e-13 * terms;
        let mut obstacle = Obstacle::NoEquilibrium;
        let mut length = 1.0;
        while length > 1e-6 {
            let trial: Vec<f64> = u.iter().zip(direction).map(|(u, d)| u + length * d).collect();
            match self.crushed(&trial) {
                Some(tet) => obstacle = Obstacle::Crushed { tet },
                None => {
                    let [then, _] = self.potential(&trial, multipliers, stiffness);
                    if then <= now + 1e-4 * length * slope + rounding {
                        return Ok(trial);
                    }
                }
            }
            length *= 0.5;
        }
        Err(obstacle)
    }

    /// A(λ + k g).
    fn spring_force(&self, u: &[f64], multipliers: &[f64], stiffness: f64) -> Vec<f64> {
        let gaps = self.springs.gaps(u);
        let tension = Mat::from_fn(gaps.len(), 1, |i, _| multipliers[i] + stiffness * gaps[i]);
        let mut force = Mat::zeros(u.len(), 1);
        self.springs.a.add_times(force.as_mut(), tension.as_ref());
        force.col_as_slice(0).to_vec()
    }

    /// Ψ + λ·g + k g²/2, and the sum of the terms' magnitudes.
    fn potential(&self, u: &[f64], multipliers: &[f64], stiffness: f64) -> [f64; 2] {
        let gaps = self.springs.gaps(u);
        let strain = self.model.energy(u);
        let work: Vec<f64> = multipliers.iter().zip(&gaps).map(|(m, g)| m * g).collect();
        let stretch = 0.5 * stiffness * dot(&gaps, &gaps);
        [
            strain + work.iter().sum::<f64>() + stretch,
            strain.abs() + work.iter().map(|w| w.abs()).sum::<f64>() + stretch,
        ]
    }

    /// The first tet that `u` presses below [`LEAST_VOLUME_RATIO`].
    fn crushed(&self, u: &[f64]) -> Option<usize> {
        (0..self.model.corners().len()).into_par_iter().find_first(|&tet| {
            let gradient = self.model.displacement_gradient(tet, u);
            let ratio = (gradient + nalgebra::Matrix3::identity()).determinant();
            ratio.is_nan() || ratio < LEAST_VOLUME_RATIO
        })
    }

    /// What rounding may leave of a force that vanishes: positions are exact to ε times the body's size,
    /// and springs and elements multiply that by their stiffness.
    fn force_rounding(&self, stiffness: f64) -> f64 {
        let of_springs = stiffness * (self.springs.rest_gaps.len() as f64).sqrt();
        let of_body = self.vertex_stiffness * (self.model.n() as f64).sqrt();
        16.0 * f64::EPSILON * self.diagonal_m * (of_springs + of_body)
    }
}

/// Mean of the diagonal of K over some free vertices, in N/m.
fn mean_stiffness(stiffness: &BlockMatrix, vertices: impl Iterator<Item = usize>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for v in vertices {
        if let Some(entry) = stiffness.pattern().find(v, v as u32) {
            let block = &stiffness.blocks()[entry];
            sum += (block[0] + block[4] + block[8]) / 3.0;
            count += 1.0;
        }
    }
    if count > 0.0 { sum / count } else { 0.0 }
}

fn column(x: &[f64]) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(x, x.len(), 1)
}

fn dot(x: &[f64], y: &[f64]) -> f64 {
    x.iter().zip(y).map(|(x, y)| x * y).sum()
}

fn norm(x: &[f64]) -> f64 {
    dot(x, x).sqrt()
}
