//! The case: an incised bar, stitched, under loads that bend it well beyond the linear range, with
//! the full-order solution of each.

use faer::MatRef;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sutura_core::assembly::FullModel;
use sutura_core::build::{self, Artifacts, BuildParams, MassKind, RayleighDamping};
use sutura_core::control::Uncontrolled;
use sutura_core::edit::Edit;
use sutura_core::material::Material;
use sutura_core::testing::statics::StitchedBody;
use sutura_core::testing::{Bar, BarMesh, Cell, Cut};

/// Length, width and height in m.
const SIZE_M: [f64; 3] = [0.2, 0.05, 0.05];
/// Displacement of the tip over the length, between these.
const TIP_RATIO: [f64; 2] = [0.03, 0.08];
/// Loads.
const N_LOADS: usize = 6;
/// Stitches, and the stiffness of each in N/m.
const N_STITCHES: usize = 30;
const STITCH_N_M: f64 = 1e5;

/// Equal steps in which a load is applied.
const LOAD_STEPS: usize = 4;

/// A load in N at which the response is measured to find the one wanted.
const TRIAL_N: f64 = 0.5;

/// What random loads look like.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Load {
    /// Distributed over the body with a direction that turns along it, and over the tip's face.
    Smooth,
    /// A pull on one vertex of the tip's face, as of a user's hand.
    Pull,
}

/// The bar before the stitches, and the stitches.
pub(crate) struct Case {
    pub(crate) bar: BarMesh,
    pub(crate) params: BuildParams,
    pub(crate) edit: Vec<Edit>,
}

impl Case {
    /// 16 × 9 × 6 cells of six tets, cut to half its height: 30 pairs of vertices, all stitched.
    pub(crate) fn new() -> Case {
        let n_cells = [16, 9, 6];
        let bar = Bar { size_m: SIZE_M, n_cells, cell: Cell::Six, cut: Cut::HalfDepth }.mesh();
        let pairs = bar.pairs.clone();
        assert_eq!(pairs.len(), N_STITCHES);
        let params = BuildParams {
            materials: vec![Material::stvk(5e5, 0.4, 1000.0).unwrap()],
            tet_stiffness: [].into(),
            fixed_vertices: bar.root.clone(),
            mass: MassKind::Lumped,
            n_modes: 30,
            basis_size: 40,
            pca: Default::default(),
            n_derivative_modes: 8,
            cubature: None,
            damping: RayleighDamping { mass_per_s: 0.0, stiffness_s: 0.0 },
            seams: Vec::new(),
        };
        Case { bar, params, edit: vec![Edit::Stitch { pairs, stiffness_n_m: STITCH_N_M }] }
    }

    /// A load of about 1 N over the free degrees of freedom.
    fn load(&self, body: &Artifacts, kind: Load, random: &mut ChaCha8Rng) -> Vec<f64> {
        let mut direction = || -> [f64; 3] { [(); 3].map(|()| random.random_range(-1.0..1.0)) };
        let mut all = vec![0.0; 3 * self.bar.mesh.vertices().len()];
        let mut add = |v: u32, share: f64, force: [f64; 3]| {
            (0..3).for_each(|axis| all[3 * v as usize + axis] += share * force[axis]);
        };
        match kind {
            Load::Smooth => {
                let [face, body_force, turn] = [(); 3].map(|()| direction());
                let masses = body.lumped_mass_kg();
                let total: f64 = masses.iter().sum();
                for (v, x) in self.bar.mesh.vertices().iter().enumerate() {
                    add(v as u32, masses[v] / total, body_force);
                    add(v as u32, masses[v] / total * (2.0 * x[0] / SIZE_M[0] - 1.0), turn);
                }
                for &v in &self.bar.tip {
                    add(v, 0.3 / self.bar.tip.len() as f64, face);
                }
            }
            Load::Pull => {
                let force = direction();
                add(self.bar.tip[random.random_range(0..self.bar.tip.len())], 1.0, force);
            }
        }
        body.full_model().restrict(&all)
    }

    /// The body before the edit.
    pub(crate) fn build(&self, params: &BuildParams) -> Artifacts {
        build::build(self.bar.mesh.clone(), params, &Uncontrolled).unwrap()
    }
}

/// Loads on the stitched body and its full-order response to each.
pub(crate) struct Truth<'a> {
    pub(crate) body: StitchedBody<'a>,
    loads: Vec<Vec<f64>>,
    solutions: Vec<Vec<f64>>,
    /// Largest displacement of the tip over the length, for each load.
    pub(crate) tip_ratios: Vec<f64>,
}

impl<'a> Truth<'a> {
    /// Six random loads of one kind.
    pub(crate) fn new(case: &Case, stitched: &'a Artifacts, kind: Load) -> Truth<'a> {
        let model = stitched.full_model();
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let mut truth = Truth {
            body: StitchedBody::new(model, stitched.stitches()).unwrap(),
            loads: Vec::new(),
            solutions: Vec::new(),
            tip_ratios: Vec::new(),
        };
        for index in 0..N_LOADS {
            let shape = case.load(stitched, kind, &mut random);
            // The response is nearly linear in the load: one trial finds the factor wanted.
            let wanted = TIP_RATIO[0]
                + (TIP_RATIO[1] - TIP_RATIO[0]) * (index as f64 + 0.5) / N_LOADS as f64;
            let solve = |factor: f64| {
                let load: Vec<f64> = shape.iter().map(|f| factor * f).collect();
                let u = truth.body.equilibrium_by_steps(&load, LOAD_STEPS).unwrap().x;
                let ratio = tip_ratio(case, model, &u);
                (load, u, ratio)
            };
            let (load, u, ratio) = solve(TRIAL_N * wanted / solve(TRIAL_N).2);
            assert!((TIP_RATIO[0]..=TIP_RATIO[1]).contains(&ratio), "{kind:?} {index}: {ratio}");
            truth.loads.push(load);
            truth.solutions.push(u);
            truth.tip_ratios.push(ratio);
        }
        truth
    }

    /// M-norm error of the static solution in the subspace of `basis` over the norm of the true
    /// one, for each load; ascending. Every tet is summed: no cubature.
    pub(crate) fn errors(&self, basis: MatRef<'_, f64>) -> Vec<f64> {
        let pairs = self.loads.iter().zip(&self.solutions);
        let mut errors: Vec<f64> =
            pairs.map(|(load, u)| self.body.error_in(basis, load, u).unwrap().0).collect();
        errors.sort_by(f64::total_cmp);
        errors
    }
}

fn tip_ratio(case: &Case, model: &FullModel, u: &[f64]) -> f64 {
    let at = |v: u32| {
        let index = model.free_index(v).unwrap();
        u[3 * index..][..3].iter().map(|x| x * x).sum::<f64>().sqrt()
    };
    case.bar.tip.iter().map(|&v| at(v)).fold(0.0, f64::max) / SIZE_M[0]
}

/// Median of ascending numbers.
pub(crate) fn median(x: &[f64]) -> f64 {
    0.5 * (x[(x.len() - 1) / 2] + x[x.len() / 2])
}
