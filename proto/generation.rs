//! The arrays of a generation: `GET /v1/sessions/{id}/generations/{g|current}/…`, and the Zenoh
//! queryables of the same names.
//!
//! | resource | arrays of its frame | shape |
//! |---|---|---|
//! | `modes` | [`MODES`] | (n_modes, n_vertices, 3) |
//! | `basis` | [`BASIS`] | (r, n_vertices, 3) |
//! | `positions` | [`POSITIONS`] | (n_vertices, 3) |
//! | `mass` | [`MASS`] | (n_vertices) |
//! | `transfer` | [`TRANSFER`] | (r, r of `from`) |
//! | `delta` | [`DELTA_COLUMNS`] | (c, n_vertices, 3) |
//! | | [`DELTA_W`] | (r of `have` + c, r) |
//! | `evaluator` | [`EVALUATOR_TETS`] (u32) | (p) |
//! | | [`EVALUATOR_WEIGHTS`] | (p) |
//! | | [`EVALUATOR_VOLUMES_M3`] | (p) |
//! | | [`EVALUATOR_LAME_PA`] | (p, 2) |
//! | | [`EVALUATOR_SHAPE_GRADIENTS`] | (p, 4, 3) |
//! | | [`EVALUATOR_BASIS_ROWS`] | (p, 4, 3, r) |
//! | | [`EVALUATOR_STITCH_STIFFNESS`] | (r, r) |
//!
//! Resources of one array can be had as .npy too; `delta` and `evaluator` are frames only. Query
//! parameters: [`PARAMETER_DTYPE`], [`PARAMETER_FROM`], [`PARAMETER_HAVE`], and over Zenoh
//! [`PARAMETER_GENERATION`]. The new basis of a `delta` is `[basis of have | columns] · w`, column
//! by column.

/// `f32` (default) or `f64`: the element type of every array but [`EVALUATOR_TETS`].
pub const PARAMETER_DTYPE: &str = "dtype";
/// The generation whose coordinates a `transfer` takes; without it, the preceding one.
pub const PARAMETER_FROM: &str = "from";
/// The generation whose basis the client of a `delta` holds; required.
pub const PARAMETER_HAVE: &str = "have";
/// The generation asked for, over Zenoh: a number or `current` (default).
pub const PARAMETER_GENERATION: &str = "generation";

/// Linear modes, mass-normalised.
pub const MODES: &str = "modes";
/// Columns of the basis, UᵀMU = I.
pub const BASIS: &str = "basis";
/// Rest positions in m: those of the session's mesh, until a closing moves them.
pub const POSITIONS: &str = "positions";
/// Lumped masses in kg.
pub const MASS: &str = "mass";
/// q_new = transfer · q_old.
pub const TRANSFER: &str = "transfer";
/// Columns that the older basis lacks.
pub const DELTA_COLUMNS: &str = "columns";
/// Combination of the older basis and the new columns.
pub const DELTA_W: &str = "w";
/// The tet of each cubature point.
pub const EVALUATOR_TETS: &str = "tets";
/// Cubature weights.
pub const EVALUATOR_WEIGHTS: &str = "weights";
/// Rest volumes of the points' tets.
pub const EVALUATOR_VOLUMES_M3: &str = "volumes_m3";
/// Lamé's λ and μ of each point.
pub const EVALUATOR_LAME_PA: &str = "lame_pa";
/// Gradients of each point's four shape functions, in 1/m.
pub const EVALUATOR_SHAPE_GRADIENTS: &str = "shape_gradients";
/// Basis rows at each point's four corners.
pub const EVALUATOR_BASIS_ROWS: &str = "basis_rows";
/// Reduced stitch stiffness.
pub const EVALUATOR_STITCH_STIFFNESS: &str = "stitch_stiffness";
