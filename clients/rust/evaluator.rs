//! The reduced model as a client holds it.

use crate::arrays::{Array, Scalar, take};
use crate::error::{Error, Result};
use sutura_proto::array::Data;
use sutura_proto::frame::Frame;
use sutura_proto::generation::{
    EVALUATOR_BASIS_ROWS, EVALUATOR_DAMPING, EVALUATOR_GRAVITY_LOADS, EVALUATOR_LAME_PA,
    EVALUATOR_LAWS, EVALUATOR_MOONEY_RATIOS, EVALUATOR_SHAPE_GRADIENTS, EVALUATOR_STITCH_STIFFNESS,
    EVALUATOR_TETS, EVALUATOR_VOLUMES_M3, EVALUATOR_WEIGHTS,
};

/// All a client needs to evaluate the reduced model on its own: p points, r coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluator<T = f32> {
    /// The tet of each point.
    pub tets: Vec<u32>,
    /// Cubature weights, (p).
    pub weights: Array<T>,
    /// Rest volumes in m³, (p).
    pub volumes_m3: Array<T>,
    /// The material law of each point, by its place in `MaterialLaw`.
    pub laws: Vec<u32>,
    /// Lamé's λ and μ in Pa, (p, 2).
    pub lame_pa: Array<T>,
    /// C₀₁/(C₁₀ + C₀₁), (p).
    pub mooney_ratios: Array<T>,
    /// Gradients of the four shape functions in 1/m, (p, 4, 3).
    pub shape_gradients: Array<T>,
    /// Basis rows at the four corners, or those of an affine displacement that has the point's gradient, (p, 4, 3, r).
    pub basis_rows: Array<T>,
    /// Reduced stitch stiffness, (r, r).
    pub stitch_stiffness: Array<T>,
    /// Reduced load of unit gravity along each axis in kg, (r, 3).
    pub gravity_loads: Array<T>,
    /// Rayleigh damping: α in 1/s and β in s, (2).
    pub damping: Array<T>,
}

impl<T: Scalar> Evaluator<T> {
    pub(crate) fn decode(bytes: &[u8]) -> Result<Evaluator<T>> {
        let mut frame = Frame::decode(bytes)?;
        let stitch_stiffness = take(&mut frame, EVALUATOR_STITCH_STIFFNESS, [None, None])?;
        let tets = numbers(&mut frame, EVALUATOR_TETS)?;
        let p = Some(tets.len());
        let r = Some(stitch_stiffness.shape[1]);
        Ok(Evaluator {
            weights: take(&mut frame, EVALUATOR_WEIGHTS, [p])?,
            volumes_m3: take(&mut frame, EVALUATOR_VOLUMES_M3, [p])?,
            laws: numbers(&mut frame, EVALUATOR_LAWS)?,
            lame_pa: take(&mut frame, EVALUATOR_LAME_PA, [p, Some(2)])?,
            mooney_ratios: take(&mut frame, EVALUATOR_MOONEY_RATIOS, [p])?,
            shape_gradients: take(&mut frame, EVALUATOR_SHAPE_GRADIENTS, [p, Some(4), Some(3)])?,
            basis_rows: take(&mut frame, EVALUATOR_BASIS_ROWS, [p, Some(4), Some(3), r])?,
            gravity_loads: take(&mut frame, EVALUATOR_GRAVITY_LOADS, [r, Some(3)])?,
            damping: take(&mut frame, EVALUATOR_DAMPING, [Some(2)])?,
            tets,
            stitch_stiffness,
        })
    }
}

fn numbers(frame: &mut Frame<'_>, name: &str) -> Result<Vec<u32>> {
    match frame.take(name)?.data {
        Data::U32(numbers) => Ok(numbers.into_owned()),
        _ => Err(Error::Decode(format!("array {name:?} is not of u32"))),
    }
}

#[cfg(feature = "simulation")]
impl Evaluator<f64> {
    /// The model that the daemon evaluates and steps, for [`sutura_reduced::Simulation`]. For bodies that are
    /// held: `n_rigid_modes` is the session's, and inertia of free bodies does not travel.
    pub fn model(&self, n_rigid_modes: usize) -> Result<sutura_reduced::ReducedModel> {
        let tables = sutura_reduced::EvaluatorTables {
            tets: self.tets.clone(),
            weights: self.weights.data.clone(),
            volumes_m3: self.volumes_m3.data.clone(),
            laws: self.laws.clone(),
            lame_pa: self.lame_pa.data.clone(),
            mooney_ratios: self.mooney_ratios.data.clone(),
            shape_gradients: self.shape_gradients.data.clone(),
            basis_rows: self.basis_rows.data.clone(),
            stitch_stiffness: self.stitch_stiffness.data.clone(),
            gravity_loads: self.gravity_loads.data.clone(),
            damping: sutura_reduced::RayleighDamping {
                mass_per_s: self.damping.data[0],
                stiffness_s: self.damping.data[1],
            },
            n_rigid_modes,
            r: self.stitch_stiffness.shape[1],
        };
        sutura_reduced::ReducedModel::from_tables(&tables)
            .map_err(|error| Error::Decode(error.to_string()))
    }
}
