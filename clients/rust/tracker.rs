//! Keeping the basis in step with the generations of a state stream.

use crate::arrays::{Arrays, Basis, Generation};
use crate::error::Result;
use sutura_proto::state::StateFrame;

/// Turns states into displacements, fetching what a new generation changed when one arrives.
#[derive(Clone, Debug)]
pub struct Tracker<S> {
    source: S,
    basis: Basis,
}

impl<S: Arrays> Tracker<S> {
    /// Fetches the current basis.
    pub async fn new(source: S) -> Result<Tracker<S>> {
        let basis = source.basis(Generation::Current).await?;
        Ok(Tracker { source, basis })
    }

    /// The basis in use.
    pub fn basis(&self) -> &Basis {
        &self.basis
    }

    /// The displacement of every vertex, `n_vertices × 3`, in m, at `state`; rigid motion aside.
    pub async fn displacement(&mut self, state: &StateFrame) -> Result<Vec<f32>> {
        if state.generation != self.basis.generation() {
            self.follow(state.generation).await?;
        }
        self.basis.reconstruct(&state.q)
    }

    /// Goes over to the basis of `generation`.
    pub async fn follow(&mut self, generation: u64) -> Result<()> {
        let have = self.basis.generation();
        let which = Generation::Number(generation);
        // The difference is smaller than the basis, but there is none once the daemon has dropped the
        // old generation.
        self.basis = match self.source.delta(which, have).await {
            Ok(delta) => self.basis.updated(&delta)?,
            Err(error) if error.status() == Some(404) => self.source.basis(which).await?,
            Err(error) => return Err(error),
        };
        Ok(())
    }
}
