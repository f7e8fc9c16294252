//! The full-order model: linear tetrahedra, mass and stiffness matrices, internal forces.
//!
//! Vectors live on the *free degrees of freedom*: vertices that are neither fixed nor unused, in
//! ascending order, vertex-major (dof = 3·vertex + axis). Displacements in m, forces in N,
//! energies in J.

mod forces;
mod kernels;
pub(crate) use kernels::stresses;
pub mod mass;
pub(crate) mod patch;
pub mod sparse;
pub mod tiles;

use crate::material::{Elasticity, Hyperelastic, Law, Material, stvk};
use crate::mesh::{NO_COMPONENT, TetMesh};
use crate::pool::Tall;
use faer::{Mat, MatRef};
use mass::{Mass, MassKind};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use sparse::{BlockMatrix, Incidence, Pattern};
use std::sync::Arc;
use tiles::ElementTiles;

/// Rows of a sparse matrix that one task sums.
const ROWS_PER_TASK: usize = 512;

/// The free index of a vertex that cannot move.
pub const NOT_FREE: u32 = u32::MAX;

/// A mesh with materials and supports: everything that determines energy and forces.
#[derive(Debug)]
pub struct FullModel {
    mesh: Arc<TetMesh>,
    /// Gradients of the four shape functions of each tet, 1/m.
    gradients: Vec<[[f64; 3]; 4]>,
    volumes_m3: Vec<f64>,
    elasticities: Vec<Elasticity>,
    density_kg_m3: Vec<f64>,
    lumped_mass_kg: Vec<f64>,
    /// Free index of each vertex, or [`NOT_FREE`].
    free_of_vertex: Vec<u32>,
    free_vertices: Vec<u32>,
    /// Free indices of each tet's corners.
    corners: Vec<[u32; 4]>,
    /// Elements of `tiles` at each free vertex.
    incidence: Incidence,
    tiles: ElementTiles,
}

impl FullModel {
    /// `materials` has one entry for each domain of the mesh; `fixed` lists valid vertices.
    pub fn new(mesh: Arc<TetMesh>, materials: &[Material], fixed: &[u32]) -> FullModel {
        FullModel::heterogeneous(mesh, materials, &[], fixed)
    }

    /// The same with each tet `tet_stiffness` times as stiff as its domain's material (empty: all alike).
    pub fn heterogeneous(
        mesh: Arc<TetMesh>,
        materials: &[Material],
        tet_stiffness: &[f64],
        fixed: &[u32],
    ) -> FullModel {
        let x = |v: u32| Vector3::from(mesh.vertices()[v as usize]);
        let (gradients, volumes_m3): (Vec<_>, Vec<_>) = mesh
            .tets()
            .par_iter()
            .map(|t| {
                let edges = Matrix3::from_columns(&[
                    x(t[1]) - x(t[0]),
                    x(t[2]) - x(t[0]),
                    x(t[3]) - x(t[0]),
                ]);
                let det = edges.determinant();
                // Rows of the inverse edge matrix: cross products over the determinant.
                let g1 = edges.column(1).cross(&edges.column(2)) / det;
                let g2 = edges.column(2).cross(&edges.column(0)) / det;
                let g3 = edges.column(0).cross(&edges.column(1)) / det;
                let g0 = -(g1 + g2 + g3);
                ([g0.into(), g1.into(), g2.into(), g3.into()], det / 6.0)
            })
            .unzip();
        let of_tet = |t: usize| &materials[mesh.domain_of_tet()[t] as usize];
        let n_tets = mesh.tets().len();
        let factor = |t: usize| tet_stiffness.get(t).copied().unwrap_or(1.0);
        let elasticities: Vec<Elasticity> =
            (0..n_tets).map(|t| of_tet(t).elasticity(factor(t))).collect();
        let density_kg_m3: Vec<f64> = (0..n_tets).map(|t| of_tet(t).density_kg_m3()).collect();
        let mut lumped_mass_kg = vec![0.0; mesh.vertices().len()];
        for (t, corners) in mesh.tets().iter().enumerate() {
            for &v in corners {
                lumped_mass_kg[v as usize] += 0.25 * density_kg_m3[t] * volumes_m3[t];
            }
        }

        let order = morton_order(&mesh);
        let mut is_free: Vec<bool> =
            mesh.component_of_vertex().iter().map(|&c| c != NO_COMPONENT).collect();
        for &v in fixed {
            is_free[v as usize] = false;
        }
        let mut free_vertices: Vec<u32> = Vec::new();
        let mut free_of_vertex = vec![NOT_FREE; is_free.len()];
        for &v in order.iter().flat_map(|&tet| &mesh.tets()[tet as usize]) {
            if is_free[v as usize] && free_of_vertex[v as usize] == NOT_FREE {
                free_of_vertex[v as usize] = free_vertices.len() as u32;
                free_vertices.push(v);
            }
        }
        let corners: Vec<[u32; 4]> =
            mesh.tets().iter().map(|t| t.map(|v| free_of_vertex[v as usize])).collect();
        let tiles = ElementTiles::new(
            free_vertices.len(),
            &corners,
            &gradients,
            &volumes_m3,
            &elasticities,
            &order,
        );
        let of_elements = tiles.elements().iter().map(|element| &element.corners);
        let incidence = Incidence::new(free_vertices.len(), of_elements);
        FullModel {
            mesh,
            gradients,
            volumes_m3,
            elasticities,
            density_kg_m3,
            lumped_mass_kg,
            free_of_vertex,
            free_vertices,
            corners,
            incidence,
            tiles,
        }
    }

    /// The mesh.
    pub fn mesh(&self) -> &Arc<TetMesh> {
        &self.mesh
    }
    /// Free degrees of freedom: 3 × free vertices.
    pub fn n(&self) -> usize {
        3 * self.free_vertices.len()
    }
    /// The vertices that may move, neighbours close to one another.
    pub fn free_vertices(&self) -> &[u32] {
        &self.free_vertices
    }
    /// Free index of `vertex`, if it may move.
    pub fn free_index(&self, vertex: u32) -> Option<usize> {
        let index = self.free_of_vertex[vertex as usize];
        (index != NOT_FREE).then_some(index as usize)
    }
    /// Free indices ([`NOT_FREE`] for fixed ones) of the corners of each tet.
    pub fn corners(&self) -> &[[u32; 4]] {
        &self.corners
    }
    /// Gradients of the four shape functions of each tet, in 1/m.
    pub fn gradients(&self) -> &[[[f64; 3]; 4]] {
        &self.gradients
    }
    /// Rest volume of each tet in m³.
    pub fn volumes_m3(&self) -> &[f64] {
        &self.volumes_m3
    }
    /// The material of each tet.
    pub fn elasticities(&self) -> &[Elasticity] {
        &self.elasticities
    }

    /// Spreads a vector over the free degrees of freedom to all vertices; the others get 0.
    pub fn expand(&self, free: &[f64]) -> Vec<f64> {
        let mut all = vec![0.0; 3 * self.free_of_vertex.len()];
        for (&v, three) in self.free_vertices.iter().zip(free.chunks_exact(3)) {
            all[3 * v as usize..][..3].copy_from_slice(three);
        }
        all
    }

    /// What a vector over all vertices (3·n_vertices) has at the free degrees of freedom, in their order: undoes
    /// [`FullModel::expand`].
    pub fn restrict(&self, all: &[f64]) -> Vec<f64> {
        self.free_vertices.iter().flat_map(|&v| &all[3 * v as usize..][..3]).copied().collect()
    }

    /// Lumped mass of every vertex of the mesh in kg: ρV/4 of each tet at each of its corners.
    pub fn lumped_mass_kg(&self) -> &[f64] {
        &self.lumped_mass_kg
    }

    /// The pattern of the stiffness matrix, with the couplings of `pairs` (vertices) added.
    pub fn pattern(&self, pairs: &[[u32; 2]]) -> Pattern {
        let pairs: Vec<[u32; 2]> =
            pairs.iter().map(|p| p.map(|v| self.free_of_vertex[v as usize])).collect();
        let corners = |element: usize| &self.tiles.elements()[element].corners;
        Pattern::of_incidence(&self.incidence, corners, &pairs)
    }

    /// The consistent or lumped mass matrix over the free degrees of freedom.
    pub fn mass(&self, kind: MassKind, pattern: &Arc<Pattern>) -> Mass {
        match kind {
            MassKind::Lumped => {
                let all = &self.lumped_mass_kg;
                Mass::Lumped(self.free_vertices.iter().map(|&v| all[v as usize]).collect())
            }
            MassKind::Consistent => {
                let mut values = vec![0.0; pattern.n_entries()];
                self.for_each_row(pattern, &mut values, |element, a| {
                    let tet = self.tiles.elements()[element].tet as usize;
                    let share = self.density_kg_m3[tet] * self.volumes_m3[tet] / 20.0;
                    let mut row = [share; 4];
                    row[a] += share;
                    row
                });
                Mass::Consistent(sparse::ScalarMatrix::new(pattern.clone(), values))
            }
        }
    }

    /// The same over all vertices of the mesh, fixed and unused ones included.
    pub fn mass_everywhere(&self, kind: MassKind) -> Mass {
        let tets = self.mesh.tets();
        match kind {
            MassKind::Lumped => Mass::Lumped(self.lumped_mass_kg.clone()),
            MassKind::Consistent => {
                let pattern = Arc::new(Pattern::new(self.free_of_vertex.len(), tets, &[]));
                let mut values = vec![0.0; pattern.n_entries()];
                for (t, corners) in tets.iter().enumerate() {
                    let share = self.density_kg_m3[t] * self.volumes_m3[t] / 20.0;
                    for &v in corners {
                        for &w in corners {
                            if let Some(entry) = pattern.find(v as usize, w) {
                                values[entry] += if v == w { 2.0 * share } else { share };
                            }
                        }
                    }
                }
                Mass::Consistent(sparse::ScalarMatrix::new(pattern, values))
            }
        }
    }

    /// K = ∂f_int/∂u at rest.
    pub fn rest_stiffness(&self, pattern: &Arc<Pattern>) -> BlockMatrix {
        let mut blocks = vec![[0.0; 9]; pattern.n_entries()];
        self.for_each_row(pattern, &mut blocks, |element, a| {
            let element = &self.tiles.elements()[element];
            let (g, mu) = (element.gradients(), element.volume_mu);
            // K_ab = V (λ gₐg_bᵀ + μ g_bgₐᵀ + μ gₐ·g_b I)
            let mut row = [ZERO_BLOCK; 4];
            for b in 0..4 {
                add_dyads(&mut row[b], [element.volume_lambda, mu], &g[a], &g[b]);
                let dot = mu * (g[a][0] * g[b][0] + g[a][1] * g[b][1] + g[a][2] * g[b][2]);
                for (axis, numbers) in row[b].iter_mut().enumerate() {
                    numbers[axis] += dot;
                }
            }
            row
        });
        BlockMatrix::new(pattern.clone(), blocks)
    }

    /// The tangent stiffness ∂f_int/∂u at displacement `u` (free degrees of freedom).
    pub fn tangent_stiffness(&self, u: &[f64], pattern: &Arc<Pattern>) -> BlockMatrix {
        struct Deformed {
            /// F∇N of the corners, 1/m.
            gradients: [[f64; 3]; 4],
            /// VμFFᵀ.
            shear: [[f64; 3]; 3],
            /// V gₐᵀS g_b.
            pull: [[f64; 4]; 4],
        }
        let deformed: Vec<Deformed> = self
            .tiles
            .elements()
            .par_iter()
            .map(|element| {
                let tet = element.tet as usize;
                let d = self.displacement_gradient(tet, u);
                let f = d + Matrix3::identity();
                let g = self.gradients[tet].map(Vector3::from);
                let lame = self.elasticities[tet].lame;
                let s = stvk::second_stress(&stvk::green_strain(&d), lame);
                let sg = g.map(|g| s * g * self.volumes_m3[tet]);
                Deformed {
                    gradients: g.map(|g| (f * g).into()),
                    shear: (f * f.transpose() * element.volume_mu).into(),
                    pull: sg.map(|sg| g.map(|g| sg.dot(&g))),
                }
            })
            .collect();
        let mut blocks = vec![[0.0; 9]; pattern.n_entries()];
        self.for_each_row(pattern, &mut blocks, |at, a| {
            let (element, Deformed { gradients: h, shear, pull }) =
                (&self.tiles.elements()[at], &deformed[at]);
            if element.law != Law::StVenantKirchhoff {
                return self.tangent_row(element.tet as usize, a, u);
            }
            let (g, lame) = (element.gradients(), [element.volume_lambda, element.volume_mu]);
            // K_ab = V [λ hₐh_bᵀ + μ h_bhₐᵀ + μ gₐ·g_b FFᵀ + (gₐᵀ S g_b) I] with h = Fg.
            let mut row = [ZERO_BLOCK; 4];
            for b in 0..4 {
                add_dyads(&mut row[b], lame, &h[a], &h[b]);
                let dot = g[a][0] * g[b][0] + g[a][1] * g[b][1] + g[a][2] * g[b][2];
                for r in 0..3 {
                    for c in 0..3 {
                        row[b][r][c] += dot * shear[r][c];
                    }
                    row[b][r][r] += pull[a][b];
                }
            }
            row
        });
        BlockMatrix::new(pattern.clone(), blocks)
    }

    /// Row a of the tangent stiffness of a tet of any law: V Σ_jl g_a[j] ∂P_ij/∂F_kl g_b[l]. The stress's
    /// derivative is made for each of the four rows anew: kept, it would take 650 bytes a tet.
    fn tangent_row(&self, tet: usize, a: usize, u: &[f64]) -> [PaddedBlock; 4] {
        let c = self.elasticities[tet].stress_derivative(&self.displacement_gradient(tet, u));
        let (g, volume_m3) = (&self.gradients[tet], self.volumes_m3[tet]);
        let mut row = [ZERO_BLOCK; 4];
        for (block, g_b) in row.iter_mut().zip(g) {
            for i in 0..3 {
                for k in 0..3 {
                    let mut sum = 0.0;
                    for j in 0..3 {
                        for l in 0..3 {
                            sum += g[a][j] * c[3 * i + j][3 * k + l] * g_b[l];
                        }
                    }
                    block[i][k] = volume_m3 * sum;
                }
            }
        }
        row
    }

    /// Strain energy at `u`, summed in a fixed order.
    pub fn energy(&self, u: &[f64]) -> f64 {
        let parts: Vec<f64> = (0..self.corners.len())
            .into_par_iter()
            .map(|tet| {
                let d = self.displacement_gradient(tet, u);
                self.elasticities[tet].energy_density(&d) * self.volumes_m3[tet]
            })
            .collect();
        parts.iter().sum()
    }

    /// scale·(H:x_i)x_j = scale·D²f_int(0)[x_i, x_j] for every pair i ≤ j of the columns of `x` (n×k), in the
    /// order (0, 0), (0, 1), (1, 1), (0, 2), …: n × k(k+1)/2.
    pub fn second_derivatives_at_rest(&self, x: MatRef<'_, f64>, scale: f64) -> Tall {
        self.tiles.second_derivatives_at_rest(x, scale)
    }

    /// ∇u of one tet: Σ_a u_a ⊗ ∇N_a.
    pub fn displacement_gradient(&self, tet: usize, u: &[f64]) -> Matrix3<f64> {
        let mut gradient = Matrix3::zeros();
        for (&v, g) in self.corners[tet].iter().zip(&self.gradients[tet]) {
            if v != NOT_FREE {
                let u = &u[3 * v as usize..][..3];
                gradient += Vector3::new(u[0], u[1], u[2]) * Vector3::from(*g).transpose();
            }
        }
        gradient
    }

    /// Sums the rows `terms(element, a)` of corner a, four entries, over all elements into `entries`. Each row is
    /// one thread's, its tets in a fixed order, so the sums do not depend on scheduling.
    ///
    /// Entries are found by a table over all vertices, filled for each row: a binary search in the
    /// row was half the time.
    fn for_each_row<T: Term>(
        &self,
        pattern: &Pattern,
        entries: &mut [T::Entry],
        terms: impl Fn(usize, usize) -> [T; 4] + Sync,
    ) {
        let mut rows: Vec<&mut [T::Entry]> = Vec::with_capacity(pattern.n());
        let mut rest = entries;
        for v in 0..pattern.n() {
            let (row, tail) = rest.split_at_mut(pattern.range(v).len());
            rows.push(row);
            rest = tail;
        }
        // In the order of the tiles: most tets of a row are then still in the cache.
        let mut ordered: Vec<(usize, &mut [T::Entry])> = Vec::with_capacity(pattern.n());
        for v in self.tiles.vertices() {
            ordered.push((v, std::mem::take(&mut rows[v])));
        }
        let elements = self.tiles.elements();
        ordered.par_chunks_mut(ROWS_PER_TASK).for_each_init(
            || (vec![0u32; pattern.n()], Vec::<T>::new()),
            |(place, sums), task| {
                for (v, row) in task {
                    let columns = pattern.row(*v);
                    for (at, &w) in (0..).zip(columns) {
                        place[w as usize] = at;
                    }
                    sums.clear();
                    sums.resize(columns.len(), T::ZERO);
                    for &[element, a] in self.incidence.of(*v) {
                        let terms = terms(element as usize, a as usize);
                        for (term, &w) in terms.iter().zip(&elements[element as usize].corners) {
                            if w != NOT_FREE {
                                sums[place[w as usize] as usize].add(term);
                            }
                        }
                    }
                    for (entry, sum) in row.iter_mut().zip(&*sums) {
                        *entry = sum.entry();
                    }
                }
            },
        );
    }

    /// The degrees of freedom at the four corners of `tet`, corner-major; `None` where one is fixed.
    pub fn corner_dofs(&self, tet: usize) -> [Option<usize>; 12] {
        std::array::from_fn(|i| {
            let v = self.corners[tet][i / 3];
            (v != NOT_FREE).then_some(3 * v as usize + i % 3)
        })
    }

    /// XᵀG (k×3) of X (n×k) and the loads G of unit acceleration along each axis, in kg.
    pub fn under_acceleration(&self, x: MatRef<'_, f64>) -> Mat<f64> {
        let masses: Vec<f64> =
            self.free_vertices.iter().map(|&v| self.lumped_mass_kg[v as usize]).collect();
        let of_column = |j: usize| {
            let mut sums = [0.0; 3];
            for (v, mass) in masses.iter().enumerate() {
                for (axis, sum) in sums.iter_mut().enumerate() {
                    *sum += mass * x[(3 * v + axis, j)];
                }
            }
            sums
        };
        let sums: Vec<[f64; 3]> = (0..x.ncols()).into_par_iter().map(of_column).collect();
        Mat::from_fn(x.ncols(), 3, |j, axis| sums[j][axis])
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.gradients[..])
            + size_of_val(&self.volumes_m3[..]) * 2
            + size_of_val(&self.elasticities[..])
            + size_of_val(&self.corners[..]) * 2
            + self.incidence.bytes()
            + self.tiles.bytes()
            + self.free_of_vertex.len() * (24 + 4 + 4 + 4)
    }
}

/// What the tets add to an entry of a sparse matrix.
trait Term: Copy + Send {
    const ZERO: Self;
    type Entry: Send;
    fn add(&mut self, term: &Self);
    fn entry(&self) -> Self::Entry;
}

impl Term for f64 {
    const ZERO: f64 = 0.0;
    type Entry = f64;
    #[inline(always)]
    fn add(&mut self, term: &f64) {
        *self += term;
    }
    #[inline(always)]
    fn entry(&self) -> f64 {
        *self
    }
}

/// A 3×3 block, each row with a fourth number that fills the vector.
type PaddedBlock = [[f64; 4]; 3];

const ZERO_BLOCK: PaddedBlock = [[0.0; 4]; 3];

impl Term for PaddedBlock {
    const ZERO: PaddedBlock = ZERO_BLOCK;
    type Entry = [f64; 9];
    #[inline(always)]
    fn add(&mut self, term: &PaddedBlock) {
        for r in 0..3 {
            for c in 0..4 {
                self[r][c] += term[r][c];
            }
        }
    }
    #[inline(always)]
    fn entry(&self) -> [f64; 9] {
        let [x, y, z] = self;
        [x[0], x[1], x[2], y[0], y[1], y[2], z[0], z[1], z[2]]
    }
}

/// Adds λ abᵀ + μ baᵀ.
#[inline(always)]
fn add_dyads(block: &mut PaddedBlock, [lambda, mu]: [f64; 2], a: &[f64; 3], b: &[f64; 3]) {
    let (wide_a, wide_b) = ([a[0], a[1], a[2], 0.0], [b[0], b[1], b[2], 0.0]);
    for r in 0..3 {
        for c in 0..4 {
            block[r][c] += lambda * a[r] * wide_b[c] + mu * b[r] * wide_a[c];
        }
    }
}

/// The tets along a Morton curve through their centroids: neighbours in the order are mostly
/// neighbours in space, whatever order the mesh's author chose.
fn morton_order(mesh: &TetMesh) -> Vec<u32> {
    let centroid = |corners: &[u32; 4]| {
        corners.iter().map(|&v| Vector3::from(mesh.vertices()[v as usize])).sum::<Vector3<f64>>()
            / 4.0
    };
    let centroids: Vec<Vector3<f64>> = mesh.tets().par_iter().map(centroid).collect();
    let low = centroids.iter().fold(Vector3::repeat(f64::INFINITY), |low, c| low.inf(c));
    // Ten bits an axis: cells of a thousandth of the body, some tets in each.
    let cells_per_m = 1023.0 / mesh.diagonal();
    let spread = |bits: u64| {
        let bits = (bits | bits << 16) & 0x0300_00ff;
        let bits = (bits | bits << 8) & 0x0300_f00f;
        let bits = (bits | bits << 4) & 0x030c_30c3;
        (bits | bits << 2) & 0x0924_9249
    };
    let mut keyed: Vec<u64> = centroids
        .par_iter()
        .enumerate()
        .map(|(tet, centroid)| {
            let cell = (centroid - low) * cells_per_m;
            let key = cell.iter().fold(0, |key, &x| key << 1 | spread(x as u64));
            key << 32 | tet as u64
        })
        .collect();
    keyed.par_sort_unstable();
    keyed.into_iter().map(|key| key as u32).collect()
}
