//! Random loads that bend a stitched body well beyond the linear range, with the full-order solution of
//! each.

use crate::bodies::Failure;
use crate::measure::Check;
use faer::MatRef;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use sutura_core::build::Artifacts;
use sutura_core::linalg::{self, SmallCholesky};
use sutura_core::testing::statics::{self, StitchedBody};

/// Loads of each kind.
pub(crate) const N_LOADS: usize = 6;

/// Largest displacement over the body's length, between these; the loads of one kind are spread
/// evenly over the range.
pub(crate) const DISPLACEMENT_RATIO: [f64; 2] = [0.03, 0.08];

/// Width of a pull (standard deviation of its bell), over the body's length.
const PULL_WIDTH: f64 = 0.05;

/// A pull acts at least so far from every support, over the body's length: nearer, a displacement of
/// the size wanted would tear the body.
const PULL_DISTANCE: f64 = 0.25;

/// Corrections of a load's size.
const MOST_CORRECTIONS: usize = 6;

/// What random loads look like.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Kind {
    /// A force on all of the body: per unit of mass, a random vector and a random linear function of
    /// the place.
    Smooth,
    /// A pull in a random direction around a random vertex, fading with the distance.
    Pull,
}

impl Kind {
    pub(crate) const ALL: [Kind; 2] = [Kind::Smooth, Kind::Pull];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Kind::Smooth => "smooth",
            Kind::Pull => "pull",
        }
    }

    /// Every kind draws from a stream of its own.
    fn seed(self) -> u64 {
        match self {
            Kind::Smooth => 2,
            Kind::Pull => 3,
        }
    }

    /// A load of about 1 N over the free degrees of freedom.
    fn draw(self, body: &Artifacts, random: &mut ChaCha8Rng) -> Vec<f64> {
        let model = body.full_model();
        let vertices = body.mesh().vertices();
        let masses = body.lumped_mass_kg();
        let total: f64 = masses.iter().sum();
        let (low, high) = bounds(vertices);
        let mut vector = || -> [f64; 3] { [(); 3].map(|()| random.random_range(-1.0..1.0)) };
        let free = model.free_vertices();
        match self {
            Kind::Smooth => {
                let [even, slopes @ ..] = [(); 4].map(|()| vector());
                let at = |v: &u32| {
                    let v = *v as usize;
                    // −1 to 1 along each side of the bounding box.
                    let place: [f64; 3] = std::array::from_fn(|axis| {
                        2.0 * (vertices[v][axis] - low[axis]) / (high[axis] - low[axis]) - 1.0
                    });
                    [0, 1, 2].map(|i| {
                        let slope: f64 = (0..3).map(|axis| slopes[axis][i] * place[axis]).sum();
                        masses[v] / total * (even[i] + slope)
                    })
                };
                free.iter().flat_map(at).collect()
            }
            Kind::Pull => {
                let length = longest_side(vertices);
                let direction = vector();
                let supports = &body.params().fixed_vertices;
                let is_far = |v: u32| {
                    let reach = PULL_DISTANCE * length;
                    supports.iter().all(|&s| distance(vertices, v, s) > reach)
                };
                let far: Vec<u32> = free.iter().copied().filter(|&v| is_far(v)).collect();
                let from = if far.is_empty() { free } else { &far };
                let centre = from[random.random_range(0..from.len())];
                let bell = |v: u32| {
                    let d = distance(vertices, v, centre) / (PULL_WIDTH * length);
                    masses[v as usize] * (-0.5 * d * d).exp()
                };
                let sum: f64 = free.iter().map(|&v| bell(v)).sum();
                free.iter().flat_map(|&v| direction.map(|d| bell(v) / sum * d)).collect()
            }
        }
    }
}

fn bounds(vertices: &[[f64; 3]]) -> ([f64; 3], [f64; 3]) {
    let mut bounds = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for x in vertices {
        for (axis, x) in x.iter().enumerate() {
            bounds.0[axis] = bounds.0[axis].min(*x);
            bounds.1[axis] = bounds.1[axis].max(*x);
        }
    }
    bounds
}

/// The body's length: the longest side of its bounding box, in m.
fn longest_side(vertices: &[[f64; 3]]) -> f64 {
    let (low, high) = bounds(vertices);
    (0..3).map(|axis| high[axis] - low[axis]).fold(0.0, f64::max)
}

fn distance(vertices: &[[f64; 3]], v: u32, w: u32) -> f64 {
    let [a, b] = [v, w].map(|v| vertices[v as usize]);
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

/// One load and the body's response to it at full order.
pub(crate) struct Case {
    /// In N, over the free degrees of freedom.
    pub(crate) load: Vec<f64>,
    /// In m, likewise.
    pub(crate) displacement: Vec<f64>,
    /// Strain energy less the work of the load, in J.
    pub(crate) potential_j: f64,
    pub(crate) summary: Summary,
}

/// What is told of a case.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Summary {
    pub(crate) kind: Kind,
    /// Sum of the absolute values of all forces, in N.
    pub(crate) force_n: f64,
    /// Largest displacement over the body's length.
    pub(crate) displacement_ratio: f64,
    /// M-norm distance of the linear response from the true one, over the true one's norm.
    pub(crate) nonlinearity: f64,
    /// What is left of the load unbalanced.
    pub(crate) residual: f64,
    pub(crate) newton_iterations: usize,
}

/// The loads of one kind on `stitched`, a body from scratch whose reduced model finds how large each
/// has to be; the full-order solution starts from the reduced one.
pub(crate) fn cases(
    stitched: &Artifacts,
    body: &StitchedBody<'_>,
    kind: Kind,
) -> Result<Vec<Case>, Failure> {
    let length = longest_side(stitched.mesh().vertices());
    let mut random = ChaCha8Rng::seed_from_u64(kind.seed());
    let shapes: Vec<Vec<f64>> = (0..N_LOADS).map(|_| kind.draw(stitched, &mut random)).collect();
    let wanted = |index: usize| {
        let [low, high] = DISPLACEMENT_RATIO;
        low + (high - low) * (index as f64 + 0.5) / N_LOADS as f64
    };
    let cases = shapes.iter().enumerate().map(|(index, shape)| {
        let case = solve(stitched, body, kind, shape, wanted(index), length);
        case.map_err(|error| format!("{} load {index}: {error}", kind.name()).into())
    });
    cases.collect()
}

/// What is left of a load under which no equilibrium was found.
const GIVING_WAY: f64 = 0.7;

fn solve(
    stitched: &Artifacts,
    body: &StitchedBody<'_>,
    kind: Kind,
    shape: &[f64],
    wanted: f64,
    length: f64,
) -> Result<Case, Failure> {
    let scaled = |x: &[f64], factor: f64| -> Vec<f64> { x.iter().map(|x| factor * x).collect() };
    let ratio = |u: &[f64]| {
        let squared = u.chunks_exact(3).map(|u| u.iter().map(|x| x * x).sum::<f64>());
        squared.fold(0.0, f64::max).sqrt() / length
    };
    let basis = stitched.basis();
    let full = |q: &[f64]| linalg::product(basis, column(q)).col_as_slice(0).to_vec();
    let reduced_shape = linalg::gram(basis, column(shape));
    let reduced_shape = reduced_shape.col_as_slice(0);

    // The linear response, then the nonlinear one of the reduced model, scaled to the size wanted.
    let (model, r) = (stitched.model(), stitched.basis_size());
    let stiffness = model.evaluate(&vec![0.0; r]).stiffness;
    let stiffness = MatRef::from_row_major_slice(&stiffness, r, r);
    let linear = SmallCholesky::new(stiffness)?.solve(column(reduced_shape));
    let linear = linear.col_as_slice(0);
    let mut factor = wanted / ratio(&full(linear));
    let mut q = scaled(linear, factor);
    for _ in 0..MOST_CORRECTIONS {
        let Ok(found) = model.solve_static(&scaled(reduced_shape, factor), &q) else { break };
        let correction = wanted / ratio(&full(&found));
        factor *= correction;
        q = scaled(&found, correction);
        if (correction - 1.0).abs() < 0.05 {
            break;
        }
    }

    let [low, high] = DISPLACEMENT_RATIO;
    let mut start = full(&q);
    let mut corrections = 0;
    let (load, found) = loop {
        let load = scaled(shape, factor);
        let found = match body.equilibrium(&load, &start) {
            // The reduced model may have found too large a load, which the body gives way under.
            Err(_) if corrections < MOST_CORRECTIONS => {
                corrections += 1;
                factor *= GIVING_WAY;
                start = scaled(&start, GIVING_WAY);
                continue;
            }
            found => found?,
        };
        let reached = ratio(&found.x);
        if (low..=high).contains(&reached) || corrections == MOST_CORRECTIONS {
            break (load, found);
        }
        corrections += 1;
        factor *= wanted / reached;
        start = scaled(&found.x, wanted / reached);
    };
    let linear = body.linear_response(&load)?;
    let difference: Vec<f64> = linear.iter().zip(&found.x).map(|(l, u)| l - u).collect();
    let summary = Summary {
        kind,
        force_n: load.iter().map(|f| f.abs()).sum(),
        displacement_ratio: ratio(&found.x),
        nonlinearity: body.norm(&difference) / body.norm(&found.x),
        residual: found.residual,
        newton_iterations: found.iterations,
    };
    Ok(Case { load, displacement: found.x, potential_j: found.potential_j, summary })
}

/// What has to hold for a case to be a truth.
pub(crate) fn checks(summary: &Summary) -> [Check; 2] {
    let [low, high] = DISPLACEMENT_RATIO;
    [
        Check::at_most(
            "force that full-order statics leave unbalanced",
            summary.residual,
            statics::TOLERANCE,
        ),
        Check::at_most(
            "distance of the largest displacement from 5.5 % of the length",
            (summary.displacement_ratio - 0.5 * (low + high)).abs(),
            0.5 * (high - low),
        ),
    ]
}

fn column(x: &[f64]) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(x, x.len(), 1)
}
