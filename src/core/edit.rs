//! Edits: the only way a body changes after it was built.

use crate::mesh::TetMesh;
use std::collections::BTreeMap;

/// Identifies a stitch within its session. Never used twice along one line of generations; where a
/// session returns to an earlier generation, the names of what came after it are given out again.
pub type StitchId = u64;

/// A zero-length spring between two co-located vertices (\[M16\] eq. 4, 5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stitch {
    /// Its name in later edits.
    pub id: StitchId,
    /// The two vertices it joins (zero-based).
    pub pair: [u32; 2],
    /// Spring stiffness in N/m.
    pub stiffness_n_m: f64,
}

/// One change. A request holds several, which take effect together or not at all.
#[derive(Clone, Debug, PartialEq)]
pub enum Edit {
    /// Join pairs of co-located vertices by springs.
    Stitch {
        /// Vertex pairs (zero-based).
        pairs: Vec<[u32; 2]>,
        /// Stiffness of each spring in N/m.
        stiffness_n_m: f64,
    },
    /// Remove stitches.
    Unstitch {
        /// The stitches' names.
        stitch_ids: Vec<StitchId>,
    },
    /// Remove every stitch.
    UnstitchAll,
    /// Give stitches another stiffness; they keep their names.
    SetStiffness {
        /// The stitches' names.
        stitch_ids: Vec<StitchId>,
        /// Stiffness of each spring from now on, in N/m.
        stiffness_n_m: f64,
    },
    /// Multiply the stiffness of a domain (\[M16\] §5.1).
    ScaleStiffness {
        /// The domain's label.
        domain: i64,
        /// Relative to the stiffness in force.
        factor: f64,
    },
}

/// Why an edit is impossible, and which entry of the request is at fault.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // the messages say what the fields are
pub enum EditError {
    #[error(
        "edit {edit}, pair {pair}: vertex {vertex} is out of range, the mesh has {n_vertices} vertices"
    )]
    VertexOutOfRange { edit: usize, pair: usize, vertex: u32, n_vertices: usize },
    #[error("edit {edit}, pair {pair}: vertex {vertex} belongs to no tet")]
    UnusedVertex { edit: usize, pair: usize, vertex: u32 },
    #[error("edit {edit}, pair {pair}: a vertex cannot be stitched to itself ({vertex})")]
    SameVertex { edit: usize, pair: usize, vertex: u32 },
    #[error(
        "edit {edit}, pair {pair}: vertices {a} and {b} do not coincide, they are {distance_m:e} m apart (at most {allowed_m:e} m)"
    )]
    Apart { edit: usize, pair: usize, a: u32, b: u32, distance_m: f64, allowed_m: f64 },
    #[error(
        "edit {edit}, pair {pair}: vertices {a} and {b} are both fixed, a stitch would do nothing"
    )]
    BothFixed { edit: usize, pair: usize, a: u32, b: u32 },
    #[error("edit {edit}, pair {pair}: vertices {a} and {b} are already stitched")]
    AlreadyStitched { edit: usize, pair: usize, a: u32, b: u32 },
    #[error("edit {edit}: stiffness {stiffness_n_m:e} N/m is outside {low:e} to {high:e}")]
    Stiffness { edit: usize, kind: EditKind, stiffness_n_m: f64, low: f64, high: f64 },
    #[error("edit {edit}: there is no stitch {id}")]
    UnknownStitch { edit: usize, kind: EditKind, position: usize, id: StitchId },
    #[error("edit {edit}: the mesh has no domain {domain}")]
    UnknownDomain { edit: usize, domain: i64 },
    #[error(
        "edit {edit}: domain {domain} would be {factor:e} times as stiff as it was built, which is outside {low:e} to {high:e}"
    )]
    StiffnessFactor { edit: usize, domain: i64, factor: f64, low: f64, high: f64 },
}

/// What an edit does, whatever to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // [`Edit`] says it
pub enum EditKind {
    Stitch,
    Unstitch,
    UnstitchAll,
    SetStiffness,
    ScaleStiffness,
}

impl Edit {
    /// What it does.
    pub fn kind(&self) -> EditKind {
        match self {
            Edit::Stitch { .. } => EditKind::Stitch,
            Edit::Unstitch { .. } => EditKind::Unstitch,
            Edit::UnstitchAll => EditKind::UnstitchAll,
            Edit::SetStiffness { .. } => EditKind::SetStiffness,
            Edit::ScaleStiffness { .. } => EditKind::ScaleStiffness,
        }
    }
}

/// Stitch stiffnesses accepted, in N/m. Below, a stitch does nothing measurable; above, rounding in
/// K + AAᵀ (whose own entries are E·h, 1 to 1e6 N/m for tissue) would reach the elastic modes.
pub const STIFFNESS_RANGE_N_M: [f64; 2] = [1e-9, 1e12];

/// Vertices closer than this fraction of the body's diagonal coincide.
pub const COINCIDENCE_RATIO: f64 = 1e-9;

/// Factors on a domain's stiffness accepted, all edits so far multiplied: beyond, the eigenvalues of a
/// soft domain would come near the rounding of K's largest entries.
pub const STIFFNESS_FACTOR_RANGE: [f64; 2] = [1e-6, 1e6];

/// What edits have made of a body.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EditState {
    /// In the order in which they were made.
    stitches: Vec<Stitch>,
    next_id: StitchId,
    /// By domain label; domains as they were built are not listed.
    stiffness_factors: BTreeMap<i64, f64>,
}

impl EditState {
    /// The stitches in force.
    pub fn stitches(&self) -> &[Stitch] {
        &self.stitches
    }

    /// Factors on the stiffness of domains, by label, where they are not 1.
    pub fn stiffness_factors(&self) -> &BTreeMap<i64, f64> {
        &self.stiffness_factors
    }

    /// Applies `edits` in order and returns the new state with the names given to new stitches.
    /// `is_fixed` tells whether a vertex is held. Nothing changes on error.
    pub fn apply(
        &self,
        edits: &[Edit],
        mesh: &TetMesh,
        is_fixed: impl Fn(u32) -> bool,
    ) -> Result<(EditState, Vec<StitchId>), EditError> {
        let mut new = self.clone();
        let mut ids = Vec::new();
        let mut taken: std::collections::BTreeSet<[u32; 2]> =
            new.stitches.iter().map(|s| sorted(s.pair)).collect();
        let allowed_m = COINCIDENCE_RATIO * mesh.diagonal();
        for (edit, change) in edits.iter().enumerate() {
            let kind = change.kind();
            let named = |state: &EditState, position, id| {
                let at = state.stitches.iter().position(|stitch| stitch.id == id);
                at.ok_or(EditError::UnknownStitch { edit, kind, position, id })
            };
            match change {
                Edit::Stitch { pairs, stiffness_n_m } => {
                    check_stiffness(edit, kind, *stiffness_n_m)?;
                    for (position, &pair) in pairs.iter().enumerate() {
                        check_pair(edit, position, pair, mesh, allowed_m, &is_fixed)?;
                        let [a, b] = pair;
                        if !taken.insert(sorted(pair)) {
                            return Err(EditError::AlreadyStitched { edit, pair: position, a, b });
                        }
                        let id = new.next_id;
                        new.next_id += 1;
                        ids.push(id);
                        new.stitches.push(Stitch { id, pair, stiffness_n_m: *stiffness_n_m });
                    }
                }
                Edit::Unstitch { stitch_ids } => {
                    for (position, id) in stitch_ids.iter().enumerate() {
                        let at = named(&new, position, *id)?;
                        taken.remove(&sorted(new.stitches.remove(at).pair));
                    }
                }
                Edit::UnstitchAll => {
                    new.stitches.clear();
                    taken.clear();
                }
                Edit::SetStiffness { stitch_ids, stiffness_n_m } => {
                    check_stiffness(edit, kind, *stiffness_n_m)?;
                    for (position, id) in stitch_ids.iter().enumerate() {
                        let at = named(&new, position, *id)?;
                        new.stitches[at].stiffness_n_m = *stiffness_n_m;
                    }
                }
                Edit::ScaleStiffness { domain, factor } => {
                    new.scale_stiffness(edit, *domain, *factor, mesh)?;
                }
            }
        }
        let ids = ids.into_iter().filter(|id| new.stitches.iter().any(|s| s.id == *id)).collect();
        Ok((new, ids))
    }

    fn scale_stiffness(
        &mut self,
        edit: usize,
        domain: i64,
        factor: f64,
        mesh: &TetMesh,
    ) -> Result<(), EditError> {
        if !mesh.domains().contains(&domain) {
            return Err(EditError::UnknownDomain { edit, domain });
        }
        let factor = factor * self.stiffness_factors.get(&domain).copied().unwrap_or(1.0);
        let [low, high] = STIFFNESS_FACTOR_RANGE;
        if !(low..=high).contains(&factor) {
            return Err(EditError::StiffnessFactor { edit, domain, factor, low, high });
        }
        if factor == 1.0 {
            self.stiffness_factors.remove(&domain);
        } else {
            self.stiffness_factors.insert(domain, factor);
        }
        Ok(())
    }
}

fn check_stiffness(edit: usize, kind: EditKind, stiffness_n_m: f64) -> Result<(), EditError> {
    let [low, high] = STIFFNESS_RANGE_N_M;
    match (low..=high).contains(&stiffness_n_m) {
        true => Ok(()),
        false => Err(EditError::Stiffness { edit, kind, stiffness_n_m, low, high }),
    }
}

/// A pair's name regardless of the order of its ends.
pub(crate) fn sorted([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// Checks that a stitch between the two vertices of `pair` is possible.
pub(crate) fn check_pair(
    edit: usize,
    position: usize,
    [a, b]: [u32; 2],
    mesh: &TetMesh,
    allowed_m: f64,
    is_fixed: &impl Fn(u32) -> bool,
) -> Result<(), EditError> {
    let n_vertices = mesh.vertices().len();
    for vertex in [a, b] {
        if vertex as usize >= n_vertices {
            return Err(EditError::VertexOutOfRange { edit, pair: position, vertex, n_vertices });
        }
        if mesh.component_of_vertex()[vertex as usize] == crate::mesh::NO_COMPONENT {
            return Err(EditError::UnusedVertex { edit, pair: position, vertex });
        }
    }
    if a == b {
        return Err(EditError::SameVertex { edit, pair: position, vertex: a });
    }
    let [xa, xb] = [a, b].map(|v| nalgebra::Vector3::from(mesh.vertices()[v as usize]));
    let distance_m = (xa - xb).norm();
    if distance_m > allowed_m {
        return Err(EditError::Apart { edit, pair: position, a, b, distance_m, allowed_m });
    }
    if is_fixed(a) && is_fixed(b) {
        return Err(EditError::BothFixed { edit, pair: position, a, b });
    }
    Ok(())
}
