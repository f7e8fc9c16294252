//! The reduced model: cubature-summed energy, force and stiffness, and its time integration.

use std::sync::Arc;

/// Energy, force and tangent stiffness in reduced coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    /// Strain energy, stitches included, in J.
    pub energy_j: f64,
    /// Reduced internal force +∂Ψ/∂q, r numbers.
    pub force: Vec<f64>,
    /// Reduced tangent stiffness, r × r, row-major (symmetric).
    pub stiffness: Vec<f64>,
}

/// The evaluator as plain arrays (`p` points, `r` columns), row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct EvaluatorTables {
    /// Tet of each point, `p`.
    pub tets: Vec<u32>,
    /// Cubature weight of each point, `p`.
    pub weights: Vec<f64>,
    /// Rest volume of each point's tet in m³, `p`.
    pub volumes_m3: Vec<f64>,
    /// Lamé's λ and μ of each point in Pa, `p × 2`.
    pub lame_pa: Vec<f64>,
    /// Gradients of the four shape functions, `p × 4 × 3`, in 1/m.
    pub shape_gradients: Vec<f64>,
    /// Basis rows at the four corners, `p × 4 × 3 × r`.
    pub basis_rows: Vec<f64>,
    /// Reduced stitch stiffness ŪᵀAAᵀŪ, `r × r`.
    pub stitch_stiffness: Vec<f64>,
    /// Columns of the basis.
    pub r: usize,
}

/// A body in its subspace: small, self-contained, independent of the mesh's size.
#[derive(Debug)]
pub struct ReducedModel {}

impl ReducedModel {
    /// Number of reduced coordinates.
    pub fn r(&self) -> usize {
        unimplemented!()
    }
    /// Energy, force and stiffness at `q` (r numbers) by cubature.
    pub fn evaluate(&self, _q: &[f64]) -> Evaluation {
        unimplemented!()
    }
}

/// How the reduced equations of motion are integrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Integrator {
    /// Newmark with β = 1/4, γ = 1/2, each step solved by Newton's method.
    ImplicitNewmark,
}

/// Parameters of a [`Simulation`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulationParams {
    /// Time step in s.
    pub dt_s: f64,
    /// The integrator.
    pub integrator: Integrator,
    /// Gravity in m/s².
    pub gravity_m_s2: [f64; 3],
}

/// What one step went through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepReport {
    /// Newton iterations over all substeps.
    pub n_newton: u32,
    /// Substeps the step was split into (1 when all went well).
    pub n_substeps: u32,
    /// No substep size worked: the step was undone and the body brought to rest where it was.
    pub recovered: bool,
}

/// Why a simulation cannot run.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // the messages say what the fields are
pub enum SimulationError {
    #[error("dt_s must be positive and at most 1 s, not {0}")]
    TimeStep(f64),
    #[error("gravity_m_s2 must be finite")]
    Gravity,
    #[error(
        "the body has {n_rigid_modes} rigid modes; only bodies held in place can be simulated so far: fix vertices or stitch every component to a fixed one"
    )]
    Free { n_rigid_modes: usize },
}

/// A running simulation of one reduced model.
pub struct Simulation {}

impl Simulation {
    /// At rest at q = 0.
    pub fn new(
        _model: Arc<ReducedModel>,
        _params: SimulationParams,
    ) -> Result<Simulation, SimulationError> {
        unimplemented!()
    }
    /// Advances by `dt_s` under the reduced external force `force` (r numbers; gravity is added).
    /// Never leaves a non-finite state behind.
    pub fn step(&mut self, _force: &[f64]) -> StepReport {
        unimplemented!()
    }
    /// Changes the parameters from the next step on.
    pub fn set_params(&mut self, _params: SimulationParams) -> Result<(), SimulationError> {
        unimplemented!()
    }
    /// Carries state over to another generation: q and velocity through `transfer`
    /// (r_new × r_old, row-major).
    pub fn switch(
        &mut self,
        _model: Arc<ReducedModel>,
        _transfer: &[f64],
    ) -> Result<(), SimulationError> {
        unimplemented!()
    }
    /// Simulated time in s.
    pub fn time_s(&self) -> f64 {
        unimplemented!()
    }
    /// Reduced coordinates.
    pub fn q(&self) -> &[f64] {
        unimplemented!()
    }
    /// Reduced velocity in 1/s.
    pub fn velocity(&self) -> &[f64] {
        unimplemented!()
    }
}
