//! Edits: the only way a body changes after it was built.

use crate::mesh::{MeshError, NO_COMPONENT, TetMesh};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

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
    /// Hold vertices where they rest. A stitch both of whose ends are held stays, without effect
    /// until one of them is released.
    Fix {
        /// The vertices, none of them held yet (zero-based).
        vertices: Vec<u32>,
    },
    /// Let vertices move that were held, by the build or by an edit.
    Release {
        /// The vertices, each of them held (zero-based).
        vertices: Vec<u32>,
    },
    /// Pull pairs of vertices together that do not coincide, and stitch them.
    Close {
        /// Vertex pairs (zero-based).
        pairs: Vec<[u32; 2]>,
        /// Stiffness in N/m of each stitch, once its pair is closed. The springs that pull are as
        /// stiff as it takes.
        stiffness_n_m: f64,
        /// The widest gap accepted, in m: pairs that come as near are moved the rest of the way. Default:
        /// [`CLOSED_RATIO`] of the body's diagonal.
        max_gap_m: Option<f64>,
    },
}

/// Why an edit is impossible, and which entry of the request is at fault.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // the messages say what the fields are
pub enum EditError {
    #[error(
        "edit {edit}, entry {position}: vertex {vertex} is out of range, the mesh has {n_vertices} vertices"
    )]
    VertexOutOfRange {
        edit: usize,
        kind: EditKind,
        position: usize,
        vertex: u32,
        n_vertices: usize,
    },
    #[error("edit {edit}, entry {position}: vertex {vertex} belongs to no tet")]
    UnusedVertex { edit: usize, kind: EditKind, position: usize, vertex: u32 },
    #[error("edit {edit}, entry {position}: vertex {vertex} is fixed already, or named twice")]
    AlreadyFixed { edit: usize, position: usize, vertex: u32 },
    #[error("edit {edit}, entry {position}: vertex {vertex} is not fixed, or named twice")]
    NotFixed { edit: usize, position: usize, vertex: u32 },
    #[error("edit {edit} leaves no vertex that could move")]
    NothingFree { edit: usize },
    #[error("edit {edit}: max_gap_m must be positive and finite, not {max_gap_m}")]
    MaxGap { edit: usize, max_gap_m: f64 },
    #[error(
        "edit {edit}, pair {pair}: vertices {a} and {b} could not be pulled together, a gap of {gap_m:e} m remains (at most {allowed_m:e} m): {reason}"
    )]
    NotClosed {
        edit: usize,
        pair: usize,
        a: u32,
        b: u32,
        gap_m: f64,
        allowed_m: f64,
        reason: String,
    },
    #[error(
        "edit {edit}: the closing would open stitch {id} by {gap_m:e} m (at most {allowed_m:e} m): {reason}"
    )]
    StitchOpens { edit: usize, id: StitchId, gap_m: f64, allowed_m: f64, reason: String },
    #[error("edit {edit}: the closed shape is no valid mesh: {error}")]
    ClosedShape { edit: usize, error: MeshError },
    #[error("edit {edit}, pair {pair}: a vertex cannot be stitched to itself ({vertex})")]
    SameVertex { edit: usize, kind: EditKind, pair: usize, vertex: u32 },
    #[error(
        "edit {edit}, pair {pair}: vertices {a} and {b} do not coincide, they are {distance_m:e} m apart (at most {allowed_m:e} m)"
    )]
    Apart { edit: usize, pair: usize, a: u32, b: u32, distance_m: f64, allowed_m: f64 },
    #[error(
        "edit {edit}, pair {pair}: vertices {a} and {b} are both fixed, a stitch would do nothing"
    )]
    BothFixed { edit: usize, kind: EditKind, pair: usize, a: u32, b: u32 },
    #[error("edit {edit}, pair {pair}: vertices {a} and {b} are already stitched")]
    AlreadyStitched { edit: usize, kind: EditKind, pair: usize, a: u32, b: u32 },
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
    Fix,
    Release,
    Close,
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
            Edit::Fix { .. } => EditKind::Fix,
            Edit::Release { .. } => EditKind::Release,
            Edit::Close { .. } => EditKind::Close,
        }
    }
}

/// Stitch stiffnesses accepted, in N/m. Below, a stitch does nothing measurable; above, rounding in
/// K + AAᵀ (whose own entries are E·h, 1 to 1e6 N/m for tissue) would reach the elastic modes.
pub const STIFFNESS_RANGE_N_M: [f64; 2] = [1e-9, 1e12];

/// Vertices closer than this fraction of the body's diagonal coincide.
pub const COINCIDENCE_RATIO: f64 = 1e-9;

/// Gap of a closing's pairs that is accepted if the request names no other, as a fraction of the body's
/// diagonal: about a hundredth of an edge of the meshes that come, so that moving the two vertices
/// the rest of the way distorts no tet. (Where nothing is in the way, gaps come out a hundred thousand
/// times narrower.)
pub const CLOSED_RATIO: f64 = 1e-4;

/// Factors on a domain's stiffness accepted, all edits so far multiplied: beyond, the eigenvalues of a
/// soft domain would come near the rounding of K's largest entries.
pub const STIFFNESS_FACTOR_RANGE: [f64; 2] = [1e-6, 1e6];

/// What a body's matrices and their factorization depend on: generations that agree in it are updates
/// of one base body.
#[derive(Clone, Debug)]
pub struct BaseState {
    mesh: Arc<TetMesh>,
    fixed_vertices: BTreeSet<u32>,
    /// By domain label; domains as they were built are not listed.
    stiffness_factors: BTreeMap<i64, f64>,
    /// Stitches that the stiffness holds, by their pairs, ends ascending, with their stiffness in N/m
    /// ([`EditState::rebased`]).
    folded: BTreeMap<[u32; 2], f64>,
}

impl PartialEq for BaseState {
    fn eq(&self, other: &BaseState) -> bool {
        // The mesh is nearly always the same one: no need to look at every vertex.
        (Arc::ptr_eq(&self.mesh, &other.mesh) || self.mesh == other.mesh)
            && self.fixed_vertices == other.fixed_vertices
            && self.stiffness_factors == other.stiffness_factors
            && self.folded == other.folded
    }
}

impl BaseState {
    fn new(mesh: Arc<TetMesh>, fixed_vertices: BTreeSet<u32>) -> BaseState {
        let (stiffness_factors, folded) = (BTreeMap::new(), BTreeMap::new());
        BaseState { mesh, fixed_vertices, stiffness_factors, folded }
    }

    /// Whether both ends of a pair are held.
    fn are_fixed(&self, pair: [u32; 2]) -> bool {
        pair.iter().all(|v| self.fixed_vertices.contains(v))
    }

    /// Between two vertices that exist.
    pub(crate) fn distance_m(&self, pair: [u32; 2]) -> f64 {
        let [a, b] = pair.map(|v| nalgebra::Vector3::from(self.mesh.vertices()[v as usize]));
        (a - b).norm()
    }

    /// The mesh.
    pub fn mesh(&self) -> &Arc<TetMesh> {
        &self.mesh
    }

    /// The vertices held.
    pub fn fixed_vertices(&self) -> &BTreeSet<u32> {
        &self.fixed_vertices
    }

    /// Factors on the stiffness of domains, by label, where they are not 1.
    pub fn stiffness_factors(&self) -> &BTreeMap<i64, f64> {
        &self.stiffness_factors
    }

    /// The stitches that the stiffness holds, by their pairs, ends ascending, with their stiffness in N/m.
    pub fn folded(&self) -> &BTreeMap<[u32; 2], f64> {
        &self.folded
    }

    /// The same as stitches. Their names are of no use.
    pub(crate) fn folded_stitches(&self) -> Vec<Stitch> {
        let stitch = |(&pair, &stiffness_n_m)| Stitch { id: 0, pair, stiffness_n_m };
        self.folded.iter().map(stitch).collect()
    }
}

/// What edits have made of a body.
#[derive(Clone, Debug, PartialEq)]
pub struct EditState {
    base: BaseState,
    /// In the order in which they were made.
    stitches: Vec<Stitch>,
    next_id: StitchId,
}

impl EditState {
    /// The body as it is built: `fixed_vertices` of the mesh are held.
    pub fn new(mesh: Arc<TetMesh>, fixed_vertices: &[u32]) -> EditState {
        let fixed_vertices = fixed_vertices.iter().copied().collect();
        let base = BaseState::new(mesh, fixed_vertices);
        EditState { base, stitches: Vec::new(), next_id: 0 }
    }

    /// A state that was taken apart before, checked again as far as anything could fail by it.
    pub fn from_parts(
        mesh: Arc<TetMesh>,
        fixed_vertices: BTreeSet<u32>,
        stiffness_factors: BTreeMap<i64, f64>,
        stitches: Vec<Stitch>,
        folded: BTreeMap<[u32; 2], f64>,
        next_id: StitchId,
    ) -> Result<EditState, EditError> {
        let n_vertices = mesh.vertices().len();
        if let Some(&vertex) = fixed_vertices.iter().find(|v| **v as usize >= n_vertices) {
            let (edit, kind, position) = (0, EditKind::Fix, 0);
            return Err(EditError::VertexOutOfRange { edit, kind, position, vertex, n_vertices });
        }
        let base = BaseState::new(mesh, fixed_vertices);
        let mut state = EditState { base, stitches: Vec::new(), next_id };
        for (domain, factor) in stiffness_factors {
            state.scale_stiffness(0, domain, factor)?;
        }
        let mut names = BTreeSet::new();
        for (position, stitch) in stitches.iter().enumerate() {
            let (edit, kind, id) = (0, EditKind::Stitch, stitch.id);
            check_ends(edit, kind, position, stitch.pair, &state.base)?;
            check_stiffness(edit, kind, stitch.stiffness_n_m)?;
            if id >= next_id || !names.insert(id) {
                return Err(EditError::UnknownStitch { edit, kind, position, id });
            }
        }
        state.stitches = stitches;
        state.base.folded = folded;
        state.unfold();
        Ok(state)
    }

    /// The name that the next stitch will get.
    pub fn next_id(&self) -> StitchId {
        self.next_id
    }

    /// What takes a factorization of its own.
    pub fn base(&self) -> &BaseState {
        &self.base
    }

    /// The stitches in force.
    pub fn stitches(&self) -> &[Stitch] {
        &self.stitches
    }

    /// Those of them that the base body's stiffness does not hold: what an update adds to it.
    pub fn open_stitches(&self) -> Vec<Stitch> {
        self.stitches.iter().copied().filter(|stitch| !self.is_folded(stitch)).collect()
    }

    /// The same body with all stitches in the stiffness of its base body: so that updates begin from it
    /// as it is now.
    pub fn rebased(&self) -> EditState {
        let mut state = self.clone();
        state.base.folded =
            self.stitches.iter().map(|s| (sorted(s.pair), s.stiffness_n_m)).collect();
        state
    }

    /// This state as an update of a base body that holds stitches; `None` if those are not all among these, or
    /// the base bodies differ in more.
    pub fn on_base(&self, base: &BaseState) -> Option<EditState> {
        let mut state = self.clone();
        state.base.folded = base.folded.clone();
        state.unfold();
        (state.base == *base).then_some(state)
    }

    /// Whether there are stitches and the base body's stiffness holds all of them.
    pub fn is_folded_whole(&self) -> bool {
        !self.stitches.is_empty() && self.stitches.iter().all(|stitch| self.is_folded(stitch))
    }

    fn is_folded(&self, stitch: &Stitch) -> bool {
        self.base.folded.get(&sorted(stitch.pair)) == Some(&stitch.stiffness_n_m)
    }

    /// Updates add to the base body and take nothing from it: one that holds a stitch that there is no
    /// more, or that has another stiffness, serves no longer. The one without any does.
    fn unfold(&mut self) {
        let n_folded = self.stitches.iter().filter(|stitch| self.is_folded(stitch)).count();
        if n_folded < self.base.folded.len() {
            self.base.folded.clear();
        }
    }

    /// Applies `edits` in order and returns the new state with the names given to new stitches.
    /// `close` computes the mesh in which the pairs of [`Edit::Close`], the edit with the given number,
    /// and those of all stitches of the state coincide. Nothing changes on error.
    pub fn apply<E: From<EditError>>(
        &self,
        edits: &[Edit],
        mut close: impl FnMut(&EditState, usize, &[[u32; 2]], f64) -> Result<Arc<TetMesh>, E>,
    ) -> Result<(EditState, Vec<StitchId>), E> {
        let mut new = self.clone();
        let mut ids = Vec::new();
        for (edit, change) in edits.iter().enumerate() {
            let kind = change.kind();
            match change {
                Edit::Stitch { pairs, stiffness_n_m } => {
                    ids.extend(new.stitch(edit, kind, pairs, *stiffness_n_m)?);
                }
                Edit::Unstitch { stitch_ids } => {
                    for (position, id) in stitch_ids.iter().enumerate() {
                        let at = new.position(edit, kind, position, *id)?;
                        new.stitches.remove(at);
                    }
                }
                Edit::UnstitchAll => new.stitches.clear(),
                Edit::SetStiffness { stitch_ids, stiffness_n_m } => {
                    check_stiffness(edit, kind, *stiffness_n_m)?;
                    for (position, id) in stitch_ids.iter().enumerate() {
                        let at = new.position(edit, kind, position, *id)?;
                        new.stitches[at].stiffness_n_m = *stiffness_n_m;
                    }
                }
                Edit::ScaleStiffness { domain, factor } => {
                    new.scale_stiffness(edit, *domain, *factor)?;
                }
                Edit::Fix { vertices } => {
                    for (position, &vertex) in vertices.iter().enumerate() {
                        check_vertex(edit, kind, position, vertex, &self.base.mesh)?;
                        if !new.base.fixed_vertices.insert(vertex) {
                            return Err(EditError::AlreadyFixed { edit, position, vertex }.into());
                        }
                    }
                }
                Edit::Release { vertices } => {
                    for (position, &vertex) in vertices.iter().enumerate() {
                        check_vertex(edit, kind, position, vertex, &self.base.mesh)?;
                        if !new.base.fixed_vertices.remove(&vertex) {
                            return Err(EditError::NotFixed { edit, position, vertex }.into());
                        }
                    }
                }
                Edit::Close { pairs, stiffness_n_m, max_gap_m } => {
                    let allowed_m = new.check_closing(edit, pairs, *stiffness_n_m, *max_gap_m)?;
                    new.base.mesh = close(&new, edit, pairs, allowed_m)?;
                    ids.extend(new.stitch(edit, kind, pairs, *stiffness_n_m)?);
                }
            }
        }
        new.unfold();
        // Edits take effect together: what one fixes another may release.
        let last_fix = edits.iter().rposition(|change| change.kind() == EditKind::Fix);
        if let Some(edit) = last_fix.filter(|_| new.nothing_is_free()) {
            return Err(EditError::NothingFree { edit }.into());
        }
        let ids = ids.into_iter().filter(|id| new.stitches.iter().any(|s| s.id == *id)).collect();
        Ok((new, ids))
    }

    /// The same body with a stitch on each of `pairs` that has none.
    pub fn closed(&self, pairs: &[[u32; 2]], stiffness_n_m: f64) -> Result<EditState, EditError> {
        let stitched: BTreeSet<[u32; 2]> = self.stitches.iter().map(|s| sorted(s.pair)).collect();
        let open: Vec<[u32; 2]> =
            pairs.iter().copied().filter(|pair| !stitched.contains(&sorted(*pair))).collect();
        let mut closed = self.clone();
        closed.stitch(0, EditKind::Stitch, &open, stiffness_n_m)?;
        Ok(closed)
    }

    /// Checks that `pairs` could be stitched to each other as they are.
    pub fn check_pairs(&self, pairs: &[[u32; 2]]) -> Result<(), EditError> {
        self.clone().stitch(0, EditKind::Stitch, pairs, 1.0).map(|_| ())
    }

    /// Checks all of a closing but whether the pairs meet; returns the widest gap accepted.
    fn check_closing(
        &self,
        edit: usize,
        pairs: &[[u32; 2]],
        stiffness_n_m: f64,
        max_gap_m: Option<f64>,
    ) -> Result<f64, EditError> {
        let kind = EditKind::Close;
        check_stiffness(edit, kind, stiffness_n_m)?;
        let allowed_m = max_gap_m.unwrap_or_else(|| CLOSED_RATIO * self.base.mesh.diagonal());
        if !(allowed_m > 0.0 && allowed_m.is_finite()) {
            return Err(EditError::MaxGap { edit, max_gap_m: allowed_m });
        }
        let mut taken: BTreeSet<[u32; 2]> = self.stitches.iter().map(|s| sorted(s.pair)).collect();
        for (position, &pair) in pairs.iter().enumerate() {
            let [a, b] = pair;
            check_ends(edit, kind, position, pair, &self.base)?;
            if self.base.are_fixed(pair) {
                let (gap_m, pair) = (self.base.distance_m(pair), position);
                let reason = "both are fixed".to_owned();
                return Err(match gap_m > allowed_m {
                    true => EditError::NotClosed { edit, pair, a, b, gap_m, allowed_m, reason },
                    false => EditError::BothFixed { edit, kind, pair, a, b },
                });
            }
            if !taken.insert(sorted(pair)) {
                return Err(EditError::AlreadyStitched { edit, kind, pair: position, a, b });
            }
        }
        Ok(allowed_m)
    }

    /// Makes stitches on `pairs` and returns their names.
    fn stitch(
        &mut self,
        edit: usize,
        kind: EditKind,
        pairs: &[[u32; 2]],
        stiffness_n_m: f64,
    ) -> Result<Vec<StitchId>, EditError> {
        check_stiffness(edit, kind, stiffness_n_m)?;
        let allowed_m = COINCIDENCE_RATIO * self.base.mesh.diagonal();
        let mut taken: BTreeSet<[u32; 2]> = self.stitches.iter().map(|s| sorted(s.pair)).collect();
        let mut ids = Vec::with_capacity(pairs.len());
        for (position, &pair) in pairs.iter().enumerate() {
            check_pair(edit, kind, position, pair, &self.base, allowed_m)?;
            let [a, b] = pair;
            if !taken.insert(sorted(pair)) {
                return Err(EditError::AlreadyStitched { edit, kind, pair: position, a, b });
            }
            let id = self.next_id;
            self.next_id += 1;
            ids.push(id);
            self.stitches.push(Stitch { id, pair, stiffness_n_m });
        }
        Ok(ids)
    }

    /// Where the stitch named `id` stands.
    fn position(
        &self,
        edit: usize,
        kind: EditKind,
        position: usize,
        id: StitchId,
    ) -> Result<usize, EditError> {
        let at = self.stitches.iter().position(|stitch| stitch.id == id);
        at.ok_or(EditError::UnknownStitch { edit, kind, position, id })
    }

    fn nothing_is_free(&self) -> bool {
        let BaseState { mesh, fixed_vertices, .. } = &self.base;
        let is_used = |v: &u32| mesh.component_of_vertex()[*v as usize] != NO_COMPONENT;
        let n_used = mesh.vertices().len() - mesh.unused_vertices().len();
        fixed_vertices.len() >= n_used
            && fixed_vertices.iter().copied().filter(is_used).count() == n_used
    }

    fn scale_stiffness(&mut self, edit: usize, domain: i64, factor: f64) -> Result<(), EditError> {
        let BaseState { mesh, stiffness_factors, .. } = &mut self.base;
        if !mesh.domains().contains(&domain) {
            return Err(EditError::UnknownDomain { edit, domain });
        }
        let factor = factor * stiffness_factors.get(&domain).copied().unwrap_or(1.0);
        let [low, high] = STIFFNESS_FACTOR_RANGE;
        if !(low..=high).contains(&factor) {
            return Err(EditError::StiffnessFactor { edit, domain, factor, low, high });
        }
        if factor == 1.0 {
            stiffness_factors.remove(&domain);
        } else {
            stiffness_factors.insert(domain, factor);
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

/// Checks that `vertex` is one of a tet.
fn check_vertex(
    edit: usize,
    kind: EditKind,
    position: usize,
    vertex: u32,
    mesh: &TetMesh,
) -> Result<(), EditError> {
    let n_vertices = mesh.vertices().len();
    match mesh.component_of_vertex().get(vertex as usize) {
        None => Err(EditError::VertexOutOfRange { edit, kind, position, vertex, n_vertices }),
        Some(&NO_COMPONENT) => Err(EditError::UnusedVertex { edit, kind, position, vertex }),
        Some(_) => Ok(()),
    }
}

/// Checks that a stitch between the two vertices of `pair` is possible.
pub(crate) fn check_pair(
    edit: usize,
    kind: EditKind,
    pair: usize,
    ends: [u32; 2],
    base: &BaseState,
    allowed_m: f64,
) -> Result<(), EditError> {
    check_ends(edit, kind, pair, ends, base)?;
    let ([a, b], distance_m) = (ends, base.distance_m(ends));
    if distance_m > allowed_m {
        return Err(EditError::Apart { edit, pair, a, b, distance_m, allowed_m });
    }
    if base.are_fixed(ends) {
        return Err(EditError::BothFixed { edit, kind, pair, a, b });
    }
    Ok(())
}

/// Checks that the ends of a pair are two vertices of tets.
fn check_ends(
    edit: usize,
    kind: EditKind,
    pair: usize,
    [a, b]: [u32; 2],
    base: &BaseState,
) -> Result<(), EditError> {
    for vertex in [a, b] {
        check_vertex(edit, kind, pair, vertex, &base.mesh)?;
    }
    if a == b {
        return Err(EditError::SameVertex { edit, kind, pair, vertex: a });
    }
    Ok(())
}
