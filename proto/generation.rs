//! The arrays of a generation: `GET /v1/sessions/{id}/generations/{g|current}/…`, and the Zenoh
//! queryables of the same names.
//!
//! | resource | arrays of its frame | shape |
//! |---|---|---|
//! | `modes` | [`MODES`] | (n_modes, n_vertices, 3) |
//! | `basis` | [`BASIS`] | (r, n_vertices, 3) |
//! | `positions` | [`POSITIONS`] | (n_vertices, 3) |
//! | `mass` | [`MASS`] | (n_vertices) |
//! | `frequencies_hz` | [`FREQUENCIES_HZ`] | (n_modes) |
//! | `tets` | [`TETS`] (u32) | (n_tets, 4) |
//! | `stitches` | [`STITCHES_PAIRS`] (u32) | (s, 2) |
//! | | [`STITCHES_IDS`] (u32) | (s, 2) |
//! | | [`STITCHES_STIFFNESS_N_M`] | (s) |
//! | `transfer` | [`TRANSFER`] | (r, r of `from`) |
//! | `delta` | [`DELTA_COLUMNS`] | (c, n_vertices, 3) |
//! | | [`DELTA_W`] | (r of `have` + c, r) |
//! | `combination` | [`COMBINATION_N_VERTICES`] (u32) | (1) |
//! | | [`COMBINATION_BLOCKS`] (u32) | (b, 2) |
//! | | [`COMBINATION_BLOCK_SIZES`] (u32) | (b) |
//! | | [`COMBINATION_COLUMNS`] (u32) | (p) |
//! | | [`COMBINATION_W`] | (p, r) |
//! | | [`COMBINATION_PREPARED`] (u32) | (c, 2) |
//! | | [`COMBINATION_PREPARED_SIZES`] (u32) | (c) |
//! | `dictionary` | [`DICTIONARY`] | (columns of the blocks, n_vertices, 3) |
//! | `evaluator` | [`EVALUATOR_TETS`] (u32) | (p) |
//! | | [`EVALUATOR_WEIGHTS`] | (p) |
//! | | [`EVALUATOR_VOLUMES_M3`] | (p) |
//! | | [`EVALUATOR_LAME_PA`] | (p, 2) |
//! | | [`EVALUATOR_SHAPE_GRADIENTS`] | (p, 4, 3) |
//! | | [`EVALUATOR_BASIS_ROWS`] | (p, 4, 3, r) |
//! | | [`EVALUATOR_STITCH_STIFFNESS`] | (r, r) |
//! | | [`EVALUATOR_LAWS`] (u32) | (p) |
//! | | [`EVALUATOR_MOONEY_RATIOS`] | (p) |
//! | | [`EVALUATOR_GRAVITY_LOADS`] | (r, 3) |
//! | | [`EVALUATOR_DAMPING`] | (2) |
//!
//! Resources of one array can be had as .npy too; `delta`, `combination`, `evaluator` and
//! `stitches` are frames only. Query parameters: [`PARAMETER_DTYPE`], [`PARAMETER_FROM`], [`PARAMETER_HAVE`],
//! [`PARAMETER_BLOCKS`], and over Zenoh [`PARAMETER_GENERATION`]. The new basis of a `delta` is
//! `[basis of have | columns] · w`, column by column.
//!
//! A basis is also `D[columns] · w`: a `combination` of columns that generations share, D being its
//! blocks side by side. What an edit inside a seam makes is combined of blocks that do not change
//! as long as the body that edits start from is the same, so that a client that has fetched them
//! from `dictionary` needs the small `combination` alone. A basis that shares nothing is one block
//! and the identity.
//!
//! The name of a block or a stitch is an unsigned 64-bit number; in arrays its lower and upper 32
//! bits, so that two u32 are the bytes of the little-endian u64, and no reader needs a 64-bit integer
//! type. A block's name stands for the same columns for as long as the daemon runs and never for any
//! others; after a restart names start anew.

/// `f32` (default) or `f64`: the element type of every array that is not marked u32 above.
pub const PARAMETER_DTYPE: &str = "dtype";
/// The generation whose coordinates a `transfer` takes; without it, the preceding one.
pub const PARAMETER_FROM: &str = "from";
/// The generation whose basis the client of a `delta` holds; required.
pub const PARAMETER_HAVE: &str = "have";
/// The blocks of a `dictionary`, decimal numbers between commas; required, at most
/// [`MAX_DICTIONARY_BLOCKS`].
pub const PARAMETER_BLOCKS: &str = "blocks";
/// Most blocks of one `dictionary`.
pub const MAX_DICTIONARY_BLOCKS: usize = 64;
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
/// Frequencies of the elastic modes, ascending.
pub const FREQUENCIES_HZ: &str = "frequencies_hz";
/// The four corners of each tet (zero-based).
pub const TETS: &str = "tets";
/// The two vertices of each stitch in force (zero-based).
pub const STITCHES_PAIRS: &str = "pairs";
/// The names of the stitches, for edits of them.
pub const STITCHES_IDS: &str = "ids";
/// Their stiffness in N/m.
pub const STITCHES_STIFFNESS_N_M: &str = "stiffness_n_m";
/// q_new = transfer · q_old.
pub const TRANSFER: &str = "transfer";
/// Columns that the older basis lacks.
pub const DELTA_COLUMNS: &str = "columns";
/// Combination of the older basis and the new columns.
pub const DELTA_W: &str = "w";
/// The vertices of the mesh, over which every column has 3 numbers each.
pub const COMBINATION_N_VERTICES: &str = "n_vertices";
/// Names of the blocks of D, in order.
pub const COMBINATION_BLOCKS: &str = "blocks";
/// Columns of each block.
pub const COMBINATION_BLOCK_SIZES: &str = "block_sizes";
/// The columns of D that take part, ascending; column 0 is the first of the first block.
pub const COMBINATION_COLUMNS: &str = "columns";
/// W, a row for each of those columns.
pub const COMBINATION_W: &str = "w";
/// Names of the blocks that are prepared for further edits now: to be fetched before they come.
pub const COMBINATION_PREPARED: &str = "prepared";
/// Columns of each prepared block.
pub const COMBINATION_PREPARED_SIZES: &str = "prepared_sizes";
/// Columns of the blocks asked for, in that order.
pub const DICTIONARY: &str = "dictionary";
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
/// Basis rows at each point's four corners; at a smoothed point, those of an affine displacement that has its gradient.
pub const EVALUATOR_BASIS_ROWS: &str = "basis_rows";
/// Reduced stitch stiffness.
pub const EVALUATOR_STITCH_STIFFNESS: &str = "stitch_stiffness";
/// The material law of each point, by its place in [`crate::session::MaterialLaw`]: 0 linear, 1 stvk,
/// 2 neo_hookean, 3 mooney_rivlin, 4 corotational.
pub const EVALUATOR_LAWS: &str = "laws";
/// C₀₁/(C₁₀ + C₀₁) of each point; of effect for mooney_rivlin alone.
pub const EVALUATOR_MOONEY_RATIOS: &str = "mooney_ratios";
/// Reduced load of unit gravity along each axis, in kg.
pub const EVALUATOR_GRAVITY_LOADS: &str = "gravity_loads";
/// Rayleigh damping: α in 1/s, β in s.
pub const EVALUATOR_DAMPING: &str = "damping";
