//! Bodies prepared once and shared: sessions on equal meshes with equal parameters begin with the
//! same artifacts.

use std::sync::{Arc, Mutex, PoisonError, Weak};
use sutura_core::build::{Artifacts, BuildParams};
use sutura_core::mesh::TetMesh;

/// The first generations, and those restored, that some session still keeps.
#[derive(Default)]
pub(crate) struct PreparedBodies(Mutex<Vec<Weak<Artifacts>>>);

impl PreparedBodies {
    /// A body equal to what building `mesh` with `params` would give. Compares meshes number by
    /// number, so it belongs on a worker thread.
    pub(crate) fn find(&self, mesh: &Arc<TetMesh>, params: &BuildParams) -> Option<Arc<Artifacts>> {
        self.all().into_iter().find(|body| {
            body.is_as_built()
                && body.params() == params
                && (Arc::ptr_eq(body.mesh(), mesh) || body.mesh() == mesh)
        })
    }

    /// Every body that is offered and still there.
    pub(crate) fn all(&self) -> Vec<Arc<Artifacts>> {
        let bodies = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        bodies.iter().filter_map(Weak::upgrade).collect()
    }

    /// Offers a body to later sessions, for as long as anyone keeps it.
    pub(crate) fn add(&self, body: &Arc<Artifacts>) {
        let mut bodies = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        bodies.retain(|body| body.strong_count() > 0);
        bodies.push(Arc::downgrade(body));
    }
}
