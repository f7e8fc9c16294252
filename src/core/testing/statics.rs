//! Static equilibria of the nonlinear body, at full order and in a subspace: the truth that a basis is
//! judged by, and what the basis makes of it.

use crate::assembly::FullModel;
use crate::assembly::mass::Mass;
use crate::assembly::sparse::{BlockMatrix, Pattern};
use crate::edit::Stitch;
use crate::factorization::{SparseCholesky, SymbolicCholesky, shifted};
use crate::linalg::{self, SmallCholesky};
use crate::modes::stitched::StitchMatrix;
use faer::{Mat, MatRef};
use std::sync::Arc;

/// Newton iterations for one equilibrium.
const MOST_ITERATIONS: usize = 80;

/// Residual relative to the load at which an equilibrium is found. Where a soft part carries a stiff
/// one (50 times, 43K unknowns), rounding alone leaves 5e-9.
pub const TOLERANCE: f64 = 1e-7;

/// A tangent serves further iterations while each leaves no more of the residual than this: near the
/// solution a factorization costs more than a few steps with the last one.
const KEEPING_RATIO: f64 = 0.1;

/// Shifts by which an indefinite tangent is made to descend, relative to its diagonal.
const SHIFTS: [f64; 6] = [0.0, 1e-6, 1e-4, 1e-2, 1.0, 100.0];

/// A nonlinear body with its stitches.
pub struct StitchedBody<'a> {
    model: &'a FullModel,
    stitches: StitchMatrix,
    /// Of the tangent stiffness, stitched pairs included.
    pattern: Arc<Pattern>,
    symbolic: Arc<SymbolicCholesky>,
    /// Lumped.
    mass: Mass,
}

/// A state in which the forces balance.
#[derive(Clone, Debug)]
pub struct Equilibrium {
    /// Displacement: n numbers at full order, r in a subspace.
    pub x: Vec<f64>,
    /// Energy less the work of the load, in J.
    pub potential_j: f64,
    /// ‖f(x) − load‖/‖load‖: at most [`TOLERANCE`].
    pub residual: f64,
    /// Newton iterations made.
    pub iterations: usize,
}

impl<'a> StitchedBody<'a> {
    /// `model` with `stitches`.
    pub fn new(model: &'a FullModel, stitches: &[Stitch]) -> Result<StitchedBody<'a>, String> {
        let pairs: Vec<[u32; 2]> = stitches.iter().map(|s| s.pair).collect();
        let pattern = Arc::new(model.pattern(&pairs));
        let symbolic = SymbolicCholesky::new(pattern.clone(), 3).map_err(|e| e.to_string())?;
        let masses = model.lumped_mass_kg();
        let of_free = model.free_vertices().iter().map(|&v| masses[v as usize]).collect();
        Ok(StitchedBody {
            model,
            stitches: StitchMatrix::new(model, stitches),
            pattern,
            symbolic: Arc::new(symbolic),
            mass: Mass::Lumped(of_free),
        })
    }

    /// The lumped mass.
    pub fn mass(&self) -> &Mass {
        &self.mass
    }

    /// ‖u‖ in the norm of the mass.
    pub fn norm(&self, u: &[f64]) -> f64 {
        self.mass.gram(column(u))[(0, 0)].sqrt()
    }

    /// K̂⁻¹·`load`: the displacement (n numbers) without the nonlinear terms.
    pub fn linear_response(&self, load: &[f64]) -> Result<Vec<f64>, String> {
        Ok(self.tangent(&vec![0.0; load.len()])?(load))
    }

    /// u with f_int(u) + AAᵀu = `load` (n numbers, N), by Newton's method from `start`.
    pub fn equilibrium(&self, load: &[f64], start: &[f64]) -> Result<Equilibrium, String> {
        newton(self, load, start)
    }

    /// The same in `steps` equal parts of the load, each from the one before, the first from rest.
    pub fn equilibrium_by_steps(&self, load: &[f64], steps: usize) -> Result<Equilibrium, String> {
        let part = |step: usize| -> Vec<f64> {
            load.iter().map(|f| step as f64 / steps as f64 * f).collect()
        };
        let mut found = self.equilibrium(&part(1), &vec![0.0; load.len()])?;
        for step in 2..=steps {
            found = self.equilibrium(&part(step), &found.x)?;
        }
        Ok(found)
    }

    /// q with Uᵀf(Uq) = Uᵀ`load`, U = `basis` (n×r) and every tet summed, by Newton's method from
    /// `start` (r numbers).
    pub fn equilibrium_in(
        &self,
        basis: MatRef<'_, f64>,
        load: &[f64],
        start: &[f64],
    ) -> Result<Equilibrium, String> {
        let load = linalg::gram(basis, column(load));
        let stretch = self.stitches.transpose_times(basis);
        let stitch_stiffness = linalg::gram(stretch.as_ref(), stretch.as_ref());
        newton(&Subspace { body: self, basis, stitch_stiffness }, load.col_as_slice(0), start)
    }

    /// Coordinates of what the span of `basis` (n×r) holds of `u`, nearest in the norm of the mass.
    pub fn project(&self, basis: MatRef<'_, f64>, u: &[f64]) -> Result<Vec<f64>, String> {
        let gram = self.mass.gram(basis);
        let factor = SmallCholesky::new(gram.as_ref()).map_err(|e| e.to_string())?;
        let q = factor.solve(self.mass.inner(basis, column(u)).as_ref());
        Ok(q.col_as_slice(0).to_vec())
    }

    /// M-norm error of the static solution in the span of `basis` over the norm of the true one, `u`.
    /// The solution is the one nearest to u: Newton's method starts from u's projection.
    pub fn error_in(
        &self,
        basis: MatRef<'_, f64>,
        load: &[f64],
        u: &[f64],
    ) -> Result<(f64, Equilibrium), String> {
        let found = self.equilibrium_in(basis, load, &self.project(basis, u)?)?;
        Ok((self.distance(basis, &found.x, u), found))
    }

    /// ‖Uq − u‖/‖u‖ in the norm of the mass, U = `basis`.
    pub fn distance(&self, basis: MatRef<'_, f64>, q: &[f64], u: &[f64]) -> f64 {
        let difference = linalg::product(basis, column(q)) - column(u);
        self.norm(difference.col_as_slice(0)) / self.norm(u)
    }
}

/// A tangent, ready to be solved with.
type Tangent<'a> = Box<dyn Fn(&[f64]) -> Vec<f64> + 'a>;

/// What Newton's method minimises: energy(x) − loadᵀx.
trait Elastic {
    fn energy(&self, x: &[f64]) -> f64;
    fn force(&self, x: &[f64]) -> Vec<f64>;
    /// gap ↦ K(x)⁻¹·gap, K shifted where it is not positive definite.
    fn tangent(&self, x: &[f64]) -> Result<Tangent<'_>, String>;
}

impl Elastic for StitchedBody<'_> {
    fn energy(&self, u: &[f64]) -> f64 {
        let stretch = self.stitches.transpose_times(column(u));
        self.model.energy(u) + 0.5 * stretch.squared_norm_l2()
    }

    fn force(&self, u: &[f64]) -> Vec<f64> {
        let mut force = self.model.internal_forces(column(u));
        self.stitches.add_times(force.as_mut(), self.stitches.transpose_times(column(u)).as_ref());
        force.col_as_slice(0).to_vec()
    }

    fn tangent(&self, u: &[f64]) -> Result<Tangent<'_>, String> {
        let mut tangent = self.model.tangent_stiffness(u, &self.pattern);
        self.stitches.add_to(&mut tangent);
        // What M has to be multiplied by to be as large as K.
        let ratio = mean_diagonal(&tangent) / mean_mass(&self.mass);
        let factor = SHIFTS
            .iter()
            .find_map(|shift| {
                let shifted = shifted(&tangent, shift * ratio, &self.mass);
                SparseCholesky::with_symbolic(self.symbolic.clone(), &shifted).ok()
            })
            .ok_or("the tangent stiffness could not be factorized")?;
        Ok(Box::new(move |gap| {
            let mut step = column(gap).to_owned();
            factor.solve_in_place(step.as_mut());
            step.col_as_slice(0).to_vec()
        }))
    }
}

/// A body that moves in the span of a basis only.
struct Subspace<'a> {
    body: &'a StitchedBody<'a>,
    /// n×r.
    basis: MatRef<'a, f64>,
    /// UᵀAAᵀU.
    stitch_stiffness: Mat<f64>,
}

impl Subspace<'_> {
    fn displacement(&self, q: &[f64]) -> Vec<f64> {
        linalg::product(self.basis, column(q)).col_as_slice(0).to_vec()
    }
}

impl Elastic for Subspace<'_> {
    fn energy(&self, q: &[f64]) -> f64 {
        self.body.energy(&self.displacement(q))
    }

    fn force(&self, q: &[f64]) -> Vec<f64> {
        let force = self.body.force(&self.displacement(q));
        linalg::gram(self.basis, column(&force)).col_as_slice(0).to_vec()
    }

    fn tangent(&self, q: &[f64]) -> Result<Tangent<'_>, String> {
        let body = self.body;
        let tangent = body.model.tangent_stiffness(&self.displacement(q), &body.pattern);
        let r = self.basis.ncols();
        let mut reduced = linalg::gram(self.basis, tangent.multiply(self.basis).as_ref());
        reduced += &self.stitch_stiffness;
        let diagonal = (0..r).map(|i| reduced[(i, i)].abs()).fold(0.0, f64::max);
        let factor = SHIFTS
            .iter()
            .find_map(|shift| {
                let shifted = Mat::from_fn(r, r, |i, j| {
                    reduced[(i, j)] + if i == j { shift * diagonal } else { 0.0 }
                });
                SmallCholesky::new(shifted.as_ref()).ok()
            })
            .ok_or("the reduced tangent stiffness could not be factorized")?;
        Ok(Box::new(move |gap| factor.solve(column(gap)).col_as_slice(0).to_vec()))
    }
}

/// Newton's method with a line search on the potential; a tangent is kept while it serves.
fn newton(body: &impl Elastic, load: &[f64], start: &[f64]) -> Result<Equilibrium, String> {
    let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    let norm = |x: &[f64]| dot(x, x).sqrt();
    let energies = |x: &[f64]| {
        let energy = body.energy(x);
        (energy - dot(x, load), energy)
    };
    let mut x = start.to_vec();
    let mut residual = f64::INFINITY;
    let mut tangent = None;
    for iterations in 0..=MOST_ITERATIONS {
        let (now, energy) = energies(&x);
        let gap: Vec<f64> = load.iter().zip(body.force(&x)).map(|(f, g)| f - g).collect();
        let before = residual;
        residual = norm(&gap) / norm(load).max(f64::MIN_POSITIVE);
        if residual <= TOLERANCE {
            return Ok(Equilibrium { x, potential_j: now, residual, iterations });
        }
        let solve = match tangent.take().filter(|_| residual <= KEEPING_RATIO * before) {
            Some(kept) => kept,
            None => body.tangent(&x)?,
        };
        let step = solve(&gap);
        tangent = Some(solve);
        let slope = dot(&step, &gap);
        let rounding = 1e-13 * energy.abs();
        let mut length = 1.0;
        x = loop {
            let trial: Vec<f64> = x.iter().zip(&step).map(|(x, d)| x + length * d).collect();
            if energies(&trial).0 <= now - 1e-4 * length * slope + rounding {
                break trial;
            }
            length *= 0.5;
            if length < 1e-9 {
                return Err(format!("the line search failed at a residual of {residual:e}"));
            }
        };
    }
    Err(format!("{MOST_ITERATIONS} Newton iterations left a residual of {residual:e}"))
}

fn mean_diagonal(a: &BlockMatrix) -> f64 {
    let diagonal = |row: usize| {
        let entry = a.pattern().find(row, row as u32);
        entry.map_or(0.0, |entry| (0..3).map(|axis| a.blocks()[entry][4 * axis]).sum())
    };
    (0..a.pattern().n()).map(diagonal).sum::<f64>() / a.n() as f64
}

fn mean_mass(mass: &Mass) -> f64 {
    let Mass::Lumped(masses) = mass else { return 1.0 };
    masses.iter().sum::<f64>() / masses.len() as f64
}

fn column(x: &[f64]) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(x, x.len(), 1)
}
