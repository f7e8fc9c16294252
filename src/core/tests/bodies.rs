//! The bodies that the tests work on, and vectors of no particular symmetry.

use faer::{Mat, MatRef};
use nalgebra::Vector3;
use std::sync::Arc;
use sutura_core::build::{BuildParams, MassKind, Method, RayleighDamping, RebuildParams};
use sutura_core::edit::Edit;
use sutura_core::material::Material;
use sutura_core::mesh::TetMesh;
use sutura_core::testing::{Bar, BarMesh, Cell, Cut};

/// Stiffness of stitches in N/m, unless a test is about it.
pub(crate) const STITCH_N_M: f64 = 1e5;

/// The bar of the update tests: 0.2 × 0.05 × 0.05 m, coarse.
pub(crate) fn bar(cut: Cut) -> BarMesh {
    Bar { size_m: [0.2, 0.05, 0.05], n_cells: [12, 4, 4], cell: Cell::Five, cut }.mesh()
}

/// Its material: E = 5e5 Pa, ν = 0.4, ρ = 1000 kg/m³.
pub(crate) fn soft() -> Material {
    Material::stvk(5e5, 0.4, 1000.0).unwrap()
}

/// A build of one material with the root held: no damping, lumped mass, every tet summed.
pub(crate) fn params(bar: &BarMesh, n_modes: usize) -> BuildParams {
    BuildParams {
        materials: vec![soft()],
        tet_stiffness: [].into(),
        fixed_vertices: bar.root.clone(),
        mass: MassKind::Lumped,
        n_modes,
        basis_size: n_modes,
        pca: Default::default(),
        n_derivative_modes: 3.min(n_modes),
        cubature: None,
        damping: RayleighDamping { mass_per_s: 0.0, stiffness_s: 0.0 },
        seams: Vec::new(),
    }
}

/// A rebuild to a relative eigenvalue error of 1e-4.
pub(crate) fn by(method: Method) -> RebuildParams {
    RebuildParams::new(method, 1e-4)
}

/// Stitches on `pairs`.
pub(crate) fn stitch(pairs: &[[u32; 2]], stiffness_n_m: f64) -> Vec<Edit> {
    vec![Edit::Stitch { pairs: pairs.to_vec(), stiffness_n_m }]
}

/// A block of 2 × 2 × 2 cells whose vertices are moved about: no two tets alike.
pub(crate) fn irregular() -> Arc<TetMesh> {
    let block =
        Bar { size_m: [0.3, 0.2, 0.25], n_cells: [2, 2, 2], cell: Cell::Five, cut: Cut::Whole };
    let regular = block.mesh().mesh;
    let shift = vector(3 * regular.vertices().len(), 0.012, 1.0);
    let vertices = regular
        .vertices()
        .iter()
        .zip(shift.chunks_exact(3))
        .map(|(x, s)| std::array::from_fn(|axis| x[axis] + s[axis]))
        .collect();
    Arc::new(TetMesh::new(vertices, regular.tets().to_vec(), Vec::new()).unwrap())
}

/// `n` numbers between ± `amplitude`, without pattern for a given seed.
pub(crate) fn vector(n: usize, amplitude: f64, seed: f64) -> Vec<f64> {
    (0..n)
        .map(|i| {
            let x = (12.9898 * (i as f64 + 1.0) + 78.233 * seed).sin() * 43758.5453;
            amplitude * (2.0 * (x - x.floor()) - 1.0)
        })
        .collect()
}

/// One column.
pub(crate) fn column(x: &[f64]) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(x, x.len(), 1)
}

/// A matrix given by rows.
pub(crate) fn by_rows(x: &[f64], n_columns: usize) -> Mat<f64> {
    Mat::from_fn(x.len() / n_columns, n_columns, |i, j| x[i * n_columns + j])
}

/// Scalar product.
pub(crate) fn dot(x: &[f64], y: &[f64]) -> f64 {
    x.iter().zip(y).map(|(x, y)| x * y).sum()
}

/// Euclidean norm.
pub(crate) fn norm(x: &[f64]) -> f64 {
    dot(x, x).sqrt()
}

/// Free-dof vector of a displacement field.
pub(crate) fn field(
    mesh: &TetMesh,
    free: &[u32],
    f: impl Fn(Vector3<f64>) -> Vector3<f64>,
) -> Vec<f64> {
    free.iter()
        .flat_map(|&v| <[f64; 3]>::from(f(Vector3::from(mesh.vertices()[v as usize]))))
        .collect()
}

/// Largest relative difference of two spectra.
pub(crate) fn spectrum_error(found: &[f64], exact: &[f64]) -> f64 {
    assert_eq!(found.len(), exact.len());
    found.iter().zip(exact).map(|(f, e)| (f / e - 1.0).abs()).fold(0.0, f64::max)
}
