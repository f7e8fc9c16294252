//! Energy, force and stiffness of the reduced model at given coordinates.

use crate::problem::{Invalid, all_finite};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Most coordinate vectors in one request.
pub const MAX_BATCH: usize = 256;

/// Where to evaluate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EvaluateRequest {
    /// Reduced coordinates: `basis_size` numbers, or a list of such vectors.
    pub q: Coordinates,
    /// Sum over every tet instead of the cubature points. Default: false.
    #[serde(default)]
    pub exact: bool,
}

/// One vector of reduced coordinates, or several.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(untagged, expecting = "expected a list of numbers or a list of such lists")]
pub enum Coordinates {
    /// One vector.
    Single(Vec<f64>),
    /// Several vectors.
    Batch(Vec<Vec<f64>>),
}

impl EvaluateRequest {
    /// Refuses numbers that are not finite and batches that are too long.
    pub fn validate(&self) -> Result<(), Invalid> {
        match &self.q {
            Coordinates::Single(q) => all_finite("/q", q),
            Coordinates::Batch(batch) if batch.len() > MAX_BATCH => {
                Err(Invalid::new("/q", format!("at most {MAX_BATCH} vectors")))
            }
            Coordinates::Batch(batch) => {
                batch.iter().enumerate().try_for_each(|(i, q)| all_finite(&format!("/q/{i}"), q))
            }
        }
    }
}

/// Energy, force and tangent stiffness in reduced coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Evaluation {
    /// Strain energy in J, stitches included.
    pub energy_j: f64,
    /// Reduced internal force +∂Ψ/∂q.
    pub force: Vec<f64>,
    /// Rows of the reduced tangent stiffness.
    pub stiffness: Vec<Vec<f64>>,
}

/// The answer: one evaluation for one vector, a list for a batch.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum EvaluateReply {
    /// For one vector.
    Single(Evaluation),
    /// For a batch, in its order.
    Batch {
        /// One for each vector.
        evaluations: Vec<Evaluation>,
    },
}
