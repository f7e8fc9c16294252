//! A deformable body in its subspace: material laws, the reduced model with its exact derivatives, static
//! and dynamic solutions, contact and pulling. Nothing here is of the size of the mesh.
//!
//! The daemon's core builds a [`ReducedModel`] from a body; a client builds the same one from the
//! evaluator's tables and steps on its own.
//!
//! Pure and synchronous: no clock, files, network or environment. Models of up to 256 points are evaluated on the
//! calling thread alone; those that sum over a whole mesh use rayon's pool.

pub mod contact;
pub mod dense;
mod frame;
mod free;
mod interaction;
pub mod material;
mod modal;
mod model;
mod products;
mod simulation;
mod statics;
mod step;
mod substeps;

pub use frame::{Frame, FreeBody};
pub use interaction::{Grab, VertexRows};
pub use model::{Evaluation, EvaluatorTables, Point, RayleighDamping, ReducedModel, TableError};
pub use simulation::{
    Environment, Integrator, Simulation, SimulationError, SimulationParams, StepReport,
};
pub use statics::StaticError;
