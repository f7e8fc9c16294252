//! Edits: each request makes a new generation. These documents travel as JSON and as bincode
//! ([`crate::bus`]), so they use no serde attribute that depends on a self-describing format.

use crate::problem::{Invalid, within};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Longest deadline, in ms.
pub const MAX_DEADLINE_MS: f64 = 3.6e6;
/// Most changes in one request.
pub const MAX_EDITS: usize = 1024;
/// Most vertices in one change.
pub const MAX_VERTICES: usize = 16_777_216;
/// Most pairs, or stitch names, in one change.
pub const MAX_PAIRS: usize = 65_536;

/// Changes that take effect together or not at all.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EditRequest {
    /// The generation the edit was made for; refused with 409 if it is no longer the current one.
    #[serde(default)]
    pub base_generation: Option<u64>,
    /// A generation that the session still keeps, to return to first: undo and redo. Without edits
    /// the next generation is that one again, at no cost.
    #[serde(default)]
    pub restore: Option<u64>,
    /// How the linear modes follow. Default: `flexibility`.
    #[serde(default)]
    pub method: EditMethod,
    /// Which modal derivatives the basis gets after an edit inside a seam (`flexibility` only). Default:
    /// `prepared`.
    #[serde(default)]
    pub derivatives: EditDerivatives,
    /// Relative eigenvalue error accepted in the lower half of the modes (`flexibility` only).
    /// Default: 1e-4.
    #[serde(default = "default_tolerance")]
    pub tolerance: f64,
    /// Time in ms, from when the request comes, in which to answer with the best that fits: time spent
    /// waiting for a turn leaves less for the edit. What it leaves undone follows in the background,
    /// as a further generation that counts as this one in `base_generation`. Without it the answer is
    /// finished, however long that takes (`flexibility` only).
    #[serde(default)]
    pub deadline_ms: Option<f64>,
    /// The changes, applied in order; at least one, unless `restore` is given.
    pub edits: Vec<Edit>,
}

fn default_tolerance() -> f64 {
    1e-4
}

/// How the linear modes follow an edit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum EditMethod {
    /// Preconditioned by the cached factorization and refined to the tolerance.
    #[default]
    Flexibility,
    /// The low-rank update of Mukherjee et al. 2016, §4.1.
    LowRank,
    /// Everything anew.
    FromScratch,
}

/// Which modal derivatives the basis gets after an edit inside a seam: `prepared`, what can be combined of those of
/// the open and of the closed seam, without a solve; or `own`, those of the stitched body, solved for where its modes
/// differ from theirs by more than 0.1 %, as they may where a part of the seam is stitched. A warning tells of 3 % where
/// they are not solved for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum EditDerivatives {
    /// Combined, at the speed of a seam.
    #[default]
    Prepared,
    /// As good as those from scratch, for some dozens of solves where combined ones are not.
    Own,
}

/// One change.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Edit {
    /// Join pairs of co-located vertices by zero-length springs.
    Stitch {
        /// Vertex pairs (zero-based).
        pairs: Vec<[u32; 2]>,
        /// Stiffness of each spring in N/m.
        stiffness_n_m: f64,
    },
    /// Remove stitches.
    Unstitch {
        /// The stitches' names, from an [`EditReply`].
        stitch_ids: Vec<u64>,
    },
    /// Remove every stitch.
    UnstitchAll {},
    /// Give stitches another stiffness; they keep their names.
    SetStiffness {
        /// The stitches' names, from an [`EditReply`].
        stitch_ids: Vec<u64>,
        /// Stiffness of each spring from now on, in N/m.
        stiffness_n_m: f64,
    },
    /// Multiply the stiffness of a domain.
    ScaleStiffness {
        /// The domain's label.
        domain: i64,
        /// The factor, relative to the stiffness in force.
        factor: f64,
    },
    /// Hold vertices where they rest. A stitch both of whose ends are held stays, without effect
    /// until one of them is released. Changes the free degrees of freedom, so the body is factorized
    /// anew (unless a kept generation holds just the same vertices).
    Fix {
        /// The vertices, none of them held yet (zero-based).
        vertices: Vec<u32>,
    },
    /// Let vertices move that were held, by the session's configuration or by an edit. What nothing
    /// holds any longer floats, with rigid modes. Costs what `fix` costs.
    Release {
        /// The vertices, each of them held (zero-based).
        vertices: Vec<u32>,
    },
    /// Pull pairs of vertices together that do not coincide, and stitch them.
    ///
    /// The whole body, with its nonlinear material, is brought into static equilibrium under springs
    /// between the vertices of each pair (and of every stitch in force, so that what was closed stays
    /// so), which grow as stiff as it takes. The shape in which the pairs meet becomes the rest shape
    /// of the body, prepared anew: fetch `positions` and `mass`. It counts as free of stress; the
    /// strain energy that is dropped so is reported. Displacements (of a running simulation, too) count
    /// from the new rest shape. Seams and other vertices that coincided may no longer do so. A gap that
    /// remains too wide, because of supports or because tets would be crushed, is a 422 that names it,
    /// and nothing is changed.
    Close {
        /// Vertex pairs (zero-based).
        pairs: Vec<[u32; 2]>,
        /// Stiffness in N/m of each stitch, once its pair is closed.
        stiffness_n_m: f64,
        /// The widest gap accepted, in m: pairs that come as near are moved the rest of the way. Default:
        /// 1e-4 of the diagonal of the body's bounding box, about a hundredth of a tet's edge.
        #[serde(default)]
        max_gap_m: Option<f64>,
    },
}

impl EditRequest {
    /// The kept generation `generation` once more: undo and redo.
    pub fn restore(generation: u64) -> EditRequest {
        EditRequest { restore: Some(generation), ..EditRequest::new(Vec::new()) }
    }

    /// `edits` on whatever generation is current, by the default method and tolerance.
    pub fn new(edits: Vec<Edit>) -> EditRequest {
        EditRequest {
            base_generation: None,
            restore: None,
            method: EditMethod::default(),
            derivatives: EditDerivatives::default(),
            tolerance: default_tolerance(),
            deadline_ms: None,
            edits,
        }
    }

    /// Refuses what no body could accept. Whether vertices, stitches and domains exist, and
    /// whether pairs coincide, is for the body to say.
    pub fn validate(&self) -> Result<(), Invalid> {
        within("/tolerance", self.tolerance, 1e-14, 1.0)?;
        if let Some(deadline_ms) = self.deadline_ms {
            within("/deadline_ms", deadline_ms, 0.0, MAX_DEADLINE_MS)?;
        }
        if !(self.edits.is_empty() && self.restore.is_some()) {
            length_within("/edits", self.edits.len(), MAX_EDITS)?;
        }
        for (i, edit) in self.edits.iter().enumerate() {
            match edit {
                Edit::Stitch { pairs, stiffness_n_m } => {
                    length_within(&format!("/edits/{i}/stitch/pairs"), pairs.len(), MAX_PAIRS)?;
                    let pointer = format!("/edits/{i}/stitch/stiffness_n_m");
                    within(&pointer, *stiffness_n_m, f64::MIN_POSITIVE, f64::MAX)?;
                }
                Edit::Unstitch { stitch_ids } => {
                    let pointer = format!("/edits/{i}/unstitch/stitch_ids");
                    length_within(&pointer, stitch_ids.len(), MAX_PAIRS)?;
                }
                Edit::UnstitchAll {} => {}
                Edit::SetStiffness { stitch_ids, stiffness_n_m } => {
                    let pointer = format!("/edits/{i}/set_stiffness");
                    length_within(&format!("{pointer}/stitch_ids"), stitch_ids.len(), MAX_PAIRS)?;
                    let pointer = format!("{pointer}/stiffness_n_m");
                    within(&pointer, *stiffness_n_m, f64::MIN_POSITIVE, f64::MAX)?;
                }
                Edit::Fix { vertices } => {
                    let pointer = format!("/edits/{i}/fix/vertices");
                    length_within(&pointer, vertices.len(), MAX_VERTICES)?;
                }
                Edit::Release { vertices } => {
                    let pointer = format!("/edits/{i}/release/vertices");
                    length_within(&pointer, vertices.len(), MAX_VERTICES)?;
                }
                Edit::Close { pairs, stiffness_n_m, max_gap_m } => {
                    let pointer = format!("/edits/{i}/close");
                    length_within(&format!("{pointer}/pairs"), pairs.len(), MAX_PAIRS)?;
                    let stiffness = format!("{pointer}/stiffness_n_m");
                    within(&stiffness, *stiffness_n_m, f64::MIN_POSITIVE, f64::MAX)?;
                    if let Some(gap) = max_gap_m {
                        let pointer = format!("{pointer}/max_gap_m");
                        within(&pointer, *gap, f64::MIN_POSITIVE, f64::MAX)?;
                    }
                }
                Edit::ScaleStiffness { factor, .. } => {
                    within(&format!("/edits/{i}/scale_stiffness/factor"), *factor, 1e-9, 1e9)?;
                }
            }
        }
        Ok(())
    }
}

fn length_within(pointer: &str, length: usize, limit: usize) -> Result<(), Invalid> {
    match length {
        0 => Err(Invalid::new(pointer, "must not be empty")),
        n if n > limit => Err(Invalid::new(pointer, format!("holds {n} entries, at most {limit}"))),
        _ => Ok(()),
    }
}

/// What an edit made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct EditReply {
    /// The new generation.
    pub generation: u64,
    /// How the linear modes followed.
    pub method: EditMethod,
    /// Names of the stitches made, in the order of the request's pairs.
    pub stitch_ids: Vec<u64>,
    /// What each closing did, in the order of the request.
    pub closings: Vec<Closing>,
    /// Stitches in force.
    pub n_stitches: usize,
    /// Rigid motions that cost no energy, with the stitches in force.
    pub n_rigid_modes: usize,
    /// Eigenvalues λ = ω² of the elastic modes in 1/s², ascending.
    pub eigenvalues_per_s2: Vec<f64>,
    /// Frequencies √λ/2π of the elastic modes in Hz.
    pub frequencies_hz: Vec<f64>,
    /// The relative residual of each mode.
    pub residuals: Vec<f64>,
    /// How good the answer is, and how that is known.
    pub certificate: Certificate,
    /// Columns of the basis.
    pub basis_size: usize,
    /// The cubature rule; `null` when every tet is summed.
    pub cubature: Option<CubatureInfo>,
    /// Time spent, in ms.
    pub timings_ms: EditTimings,
    /// What the caller should know, in words.
    pub warnings: Vec<String>,
}

/// Where the modes of a generation come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// From what was prepared, without a sparse solve.
    Patched,
    /// With solves by the base body's factorization.
    Refined,
    /// From a factorization of their own, or of a new base body.
    Rebuilt,
}

/// What a generation claims of itself, estimated from residuals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Certificate {
    /// Where the modes come from.
    pub verdict: Verdict,
    /// Largest estimated relative eigenvalue error in the lower half of the modes.
    pub lower_eigenvalue_error: f64,
    /// The same in the upper half, of which a hundred times the tolerance is asked.
    pub upper_eigenvalue_error: f64,
    /// Estimated sine of the largest angle between the lower half of the modes and the exact ones.
    pub basis_angle: f64,
    /// Relative reduced-force error of the cubature on poses held out; `null` when every tet is summed.
    pub cubature_error: Option<f64>,
    /// Whether eigenvalues and cubature are within their tolerances.
    pub is_met: bool,
    /// Whether the deadline left something undone, which follows in the background.
    pub is_unfinished: bool,
}

/// What a closing ([`Edit::Close`]) did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Closing {
    /// The edit's place in its request.
    pub edit: usize,
    /// For each of its pairs the gap in m that the springs left; the pair was moved the rest of the way.
    pub gaps_m: Vec<f64>,
    /// Strain energy of the closed shape in J, which is dropped: that shape counts as free of stress.
    pub dropped_energy_j: f64,
    /// The largest displacement of a vertex in m.
    pub largest_displacement_m: f64,
    /// Imbalance of the forces at the end, relative to those that pulled.
    pub residual: f64,
}

/// Time spent in an edit, in ms.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct EditTimings {
    /// Closing of pairs that did not coincide.
    pub closing: f64,
    /// Linear modes, with the factorization and seam columns where those were redone.
    pub linear: f64,
    /// Modal derivatives.
    pub derivatives: f64,
    /// Basis and reduced tables.
    pub reduction: f64,
    /// Cubature reuse, validation, fitting.
    pub cubature: f64,
    /// From the command's start to the new generation.
    pub total: f64,
    /// Every stage by its own name.
    pub stages: BTreeMap<String, f64>,
}

/// What is known of a generation's cubature rule.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CubatureInfo {
    /// Points with positive weight.
    pub n_points: usize,
    /// Where the rule came from.
    pub source: CubatureSource,
    /// Relative reduced-force error on poses not used for fitting.
    pub validation_error: f64,
}

/// Where a cubature rule came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CubatureSource {
    /// Points and weights of the previous generation, or those trained for its seams with all pairs closed.
    Reused,
    /// Points of the previous generation, weights fitted anew, and smoothing where there is any.
    Refitted,
    /// Points chosen and weights fitted for this basis.
    Retrained,
}
