//! Sutura's numerical core: from a tetrahedral mesh to a reduced (subspace) model, and from an
//! edit to the updated one.
//!
//! Pure, synchronous, double precision. Nothing here knows a clock, the environment, the file
//! system, a network or an asynchronous runtime; see `src/ARCHITECTURE.md` for the walls.
//!
//! Entry points: [`build::build`] prepares a body, [`build::rebuild`] applies edits to it,
//! [`reduced`] evaluates and simulates the result.

pub mod assembly;
pub mod basis;
pub mod build;
pub mod closing;
pub mod control;
pub mod cubature;
pub mod derivatives;
pub mod dictionary;
pub mod edit;
pub mod factorization;
pub mod lanes;
pub mod linalg;
pub use sutura_reduced::material;
pub mod mesh;
pub mod modes;
pub mod pool;
pub mod reduced;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
