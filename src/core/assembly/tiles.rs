//! Element sums, eight vectors at a time over tiles of neighbouring tets.
//!
//! A lane is a vector (or a pair of vectors), not a tet: corner displacements are then gathered and
//! corner forces scattered as whole rows of lanes, and no instruction of the element's arithmetic is
//! scalar. Tets are sorted along a curve that fills space and cut into tiles; each tile gathers the
//! rows of its vertices once, sums into rows of its own, and these are added up vertex by vertex, in
//! the order of the tiles: results do not depend on scheduling.
//!
//! Measured for the derivative right-hand sides, in processor time a tet and pair: 7 to 9 ns, against
//! 38 ns with one tet a lane, where scalar gathers and scatters were most of the time.

use super::NOT_FREE;
use faer::{Mat, MatRef};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

/// Vectors that one pass works on.
const LANES: usize = 8;

/// Tets in a tile: its rows fit into the second-level cache, and few vertices belong to several.
const TETS_PER_TILE: usize = 1024;

/// Groups of eight results that one pass over the tets makes; bounds the memory of the tiles' rows.
const MOST_GROUPS: usize = 5;

/// Vertices whose results one task adds up.
const VERTICES_PER_TASK: usize = 512;

/// The three components of [`LANES`] vectors at one vertex.
type Row = [[f64; LANES]; 3];

const NO_ROW: Row = [[0.0; LANES]; 3];

/// Displacement gradient (by rows) and symmetric stress (xx, yy, zz, yz, zx, xy) of [`LANES`] vectors at
/// one tet, each twice in a row where lanes are to be rotated.
type Field = [[f64; 2 * LANES]; 15];

/// A tet, with all that sums over tets need of it in one place.
#[derive(Clone, Debug)]
pub struct Element {
    /// Its number in the mesh.
    pub tet: u32,
    /// Free indices of the corners, or [`NOT_FREE`].
    pub corners: [u32; 4],
    /// Rows of the corners in the tile; corners that cannot move share the row behind the last.
    rows: [u16; 4],
    /// ∇N of the last three corners, 1/m; that of the first is minus their sum.
    gradients: [[f64; 3]; 3],
    /// Vλ in N·m.
    pub volume_lambda: f64,
    /// Vμ in N·m.
    pub volume_mu: f64,
}

impl Element {
    /// ∇N of the four corners, 1/m.
    #[inline(always)]
    pub fn gradients(&self) -> [[f64; 3]; 4] {
        let [a, b, c] = self.gradients;
        [[-(a[0] + b[0] + c[0]), -(a[1] + b[1] + c[1]), -(a[2] + b[2] + c[2])], a, b, c]
    }
}

/// All tets of a body, in tiles.
#[derive(Debug)]
pub struct ElementTiles {
    /// [`TETS_PER_TILE`] to a tile.
    elements: Vec<Element>,
    /// Free vertices of each tile, in the order in which its elements name them first.
    vertices: Vec<Vec<u32>>,
    /// Where each free vertex's rows lie among the rows of all tiles: `rows[row_start[v]..]`.
    row_start: Vec<u32>,
    rows: Vec<u32>,
    n_rows: usize,
}

/// A view of one tile.
#[derive(Clone, Copy)]
struct Tile<'a> {
    elements: &'a [Element],
    vertices: &'a [u32],
}

impl ElementTiles {
    /// `corners` are free vertex indices below `n_free`, or [`NOT_FREE`]; `order` is that of the tets.
    pub fn new(
        n_free: usize,
        corners: &[[u32; 4]],
        gradients: &[[[f64; 3]; 4]],
        volumes_m3: &[f64],
        lame: &[[f64; 2]],
        order: &[u32],
    ) -> ElementTiles {
        let mut elements: Vec<Element> = order
            .par_iter()
            .map(|&tet| {
                let t = tet as usize;
                let ([lame_lambda, lame_mu], [_, g1, g2, g3]) = (lame[t], gradients[t]);
                Element {
                    tet,
                    corners: corners[t],
                    rows: [0; 4],
                    gradients: [g1, g2, g3],
                    volume_lambda: volumes_m3[t] * lame_lambda,
                    volume_mu: volumes_m3[t] * lame_mu,
                }
            })
            .collect();
        let vertices: Vec<Vec<u32>> = elements
            .par_chunks_mut(TETS_PER_TILE)
            .map_init(
                || vec![u16::MAX; n_free],
                |row_of, elements| {
                    let mut vertices = Vec::new();
                    for &v in elements.iter().flat_map(|element| &element.corners) {
                        if v != NOT_FREE && row_of[v as usize] == u16::MAX {
                            row_of[v as usize] = vertices.len() as u16;
                            vertices.push(v);
                        }
                    }
                    let rest = vertices.len() as u16;
                    for Element { rows, corners, .. } in elements {
                        *rows =
                            corners.map(|v| if v == NOT_FREE { rest } else { row_of[v as usize] });
                    }
                    vertices.iter().for_each(|&v| row_of[v as usize] = u16::MAX);
                    vertices
                },
            )
            .collect();

        let mut row_start = vec![0u32; n_free + 1];
        for &v in vertices.iter().flatten() {
            row_start[v as usize + 1] += 1;
        }
        for v in 0..n_free {
            row_start[v + 1] += row_start[v];
        }
        let mut next = row_start.clone();
        let mut rows = vec![0; row_start[n_free] as usize];
        let mut row = 0;
        for of_tile in &vertices {
            for &v in of_tile {
                rows[next[v as usize] as usize] = row;
                next[v as usize] += 1;
                row += 1;
            }
            // The row of the corners that cannot move.
            row += 1;
        }
        ElementTiles { elements, vertices, row_start, rows, n_rows: row as usize }
    }

    /// The tets in the order of the tiles.
    pub fn elements(&self) -> &[Element] {
        &self.elements
    }

    fn tiles(&self) -> impl Iterator<Item = Tile<'_>> {
        let parts = self.elements.chunks(TETS_PER_TILE).zip(&self.vertices);
        parts.map(|(elements, vertices)| Tile { elements, vertices })
    }

    /// The free vertices in the order in which the tiles first name them: neighbours are mostly near.
    pub fn vertices(&self) -> Vec<usize> {
        let mut order = Vec::with_capacity(self.row_start.len() - 1);
        let mut row = 0;
        for of_tile in &self.vertices {
            for &v in of_tile {
                if self.rows[self.row_start[v as usize] as usize] == row {
                    order.push(v as usize);
                }
                row += 1;
            }
            row += 1;
        }
        order
    }

    /// Internal force of each column of `u` (n×t), in N.
    pub fn internal_forces(&self, u: MatRef<'_, f64>) -> Mat<f64> {
        let columns: Vec<usize> = (0..u.ncols()).collect();
        let groups: Vec<Vec<Option<usize>>> = columns
            .chunks(LANES)
            .map(|lanes| lanes.iter().map(|&column| Some(column)).collect())
            .collect();
        let mut all = Mat::zeros(u.nrows(), u.ncols());
        let mut rows = self.no_rows(groups.len());
        for (batch, groups) in groups.chunks(MOST_GROUPS).enumerate() {
            let n_groups = groups.len();
            self.for_each_tile(&mut rows, n_groups, |tile, sums| {
                let x: Vec<Vec<Row>> = (0..n_groups)
                    .map(|group| tile.gather(u, (batch * MOST_GROUPS + group) * LANES))
                    .collect();
                pulp::Arch::new().dispatch(Forces { tile, x: &x, sums });
            });
            self.add_up(&rows, groups, &mut all);
        }
        all
    }

    /// scale·(H:x_i)x_j = scale·D²f(0)[x_i, x_j] for every pair i ≤ j of the columns of `x` (n×k), in the
    /// order (0, 0), (0, 1), (1, 1), (0, 2), …: n × k(k+1)/2.
    ///
    /// Columns are taken in blocks of eight. Pairs between two blocks are the eight of the one with
    /// each of the other; pairs within a block of m are i with i + d mod m for d = 0 … m/2, so that
    /// hardly a lane is idle.
    pub fn second_derivatives_at_rest(&self, x: MatRef<'_, f64>, scale: f64) -> Mat<f64> {
        let k = x.ncols();
        let mut all = Mat::zeros(x.nrows(), k * (k + 1) / 2);
        let mut rows = self.no_rows(LANES);
        for second in (0..k).step_by(LANES) {
            let count = LANES.min(k - second);
            for first in (0..=second).step_by(LANES) {
                let partners: Vec<Partner> = if first == second {
                    (0..=count / 2).map(Partner::Rotated).collect()
                } else {
                    (0..count).map(Partner::Same).collect()
                };
                for partners in partners.chunks(MOST_GROUPS) {
                    self.for_each_tile(&mut rows, partners.len(), |tile, sums| {
                        let a = tile.gather(x, first);
                        let b = (first != second).then(|| tile.gather(x, second));
                        let b = b.as_deref();
                        let kernel =
                            SecondDerivatives { tile, scale, a: &a, b, count, partners, sums };
                        pulp::Arch::new().dispatch(kernel);
                    });
                    let groups: Vec<Vec<Option<usize>>> = partners
                        .iter()
                        .map(|partner| {
                            let lanes = if first == second { count } else { LANES };
                            (0..lanes)
                                .map(|lane| {
                                    let (i, j) = (first + lane, second + partner.of(lane, count)?);
                                    let (i, j) = (i.min(j), i.max(j));
                                    Some(j * (j + 1) / 2 + i)
                                })
                                .collect()
                        })
                        .collect();
                    self.add_up(&rows, &groups, &mut all);
                }
            }
        }
        all
    }

    /// Rows of all tiles for up to [`MOST_GROUPS`] of `n_groups` groups.
    fn no_rows(&self, n_groups: usize) -> Vec<Row> {
        vec![NO_ROW; self.n_rows * n_groups.min(MOST_GROUPS)]
    }

    /// Calls `work(tile, sums)` for every tile, `sums` holding `n_groups` zero rows for each of its vertices
    /// and for the corners that cannot move.
    fn for_each_tile(
        &self,
        rows: &mut [Row],
        n_groups: usize,
        work: impl Fn(Tile<'_>, &mut [Row]) + Sync,
    ) {
        let mut pieces = Vec::with_capacity(self.vertices.len());
        let mut rest = rows;
        for tile in self.tiles() {
            let (piece, tail) = rest.split_at_mut((tile.vertices.len() + 1) * n_groups);
            pieces.push((tile, piece));
            rest = tail;
        }
        pieces.into_par_iter().for_each(|(tile, sums)| {
            sums.fill(NO_ROW);
            work(tile, sums);
        });
    }

    /// Adds up the rows of all tiles into the columns of `all`; `groups` names the column of each lane.
    fn add_up(&self, rows: &[Row], groups: &[Vec<Option<usize>>], all: &mut Mat<f64>) {
        let n_groups = groups.len();
        all.as_mut().par_row_chunks_mut(3 * VERTICES_PER_TASK).enumerate().for_each(
            |(task, mut chunk)| {
                let first = task * VERTICES_PER_TASK;
                let n_vertices = chunk.nrows() / 3;
                let mut sums = vec![NO_ROW; n_vertices];
                for (group, columns) in groups.iter().enumerate() {
                    for (v, sum) in (first..).zip(&mut sums) {
                        *sum = NO_ROW;
                        for &row in
                            &self.rows[self.row_start[v] as usize..self.row_start[v + 1] as usize]
                        {
                            for (sum, part) in
                                sum.iter_mut().zip(&rows[row as usize * n_groups + group])
                            {
                                for (s, p) in sum.iter_mut().zip(part) {
                                    *s += p;
                                }
                            }
                        }
                    }
                    for (lane, column) in columns.iter().enumerate() {
                        let Some(column) = column else { continue };
                        let to = chunk.as_mut().col_mut(*column);
                        let Some(to) = to.try_as_col_major_mut() else { continue };
                        for (to, sum) in to.as_slice_mut().chunks_exact_mut(3).zip(&sums) {
                            for (to, axis) in to.iter_mut().zip(sum) {
                                *to = axis[lane];
                            }
                        }
                    }
                }
            },
        );
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.elements[..])
            + self.vertices.iter().map(|of_tile| size_of_val(&of_tile[..])).sum::<usize>()
            + size_of_val(&self.rows[..])
            + size_of_val(&self.row_start[..])
    }
}

impl Tile<'_> {
    /// The rows of columns `first..` of `x`, [`LANES`] at most, with a row at rest behind them.
    fn gather(&self, x: MatRef<'_, f64>, first: usize) -> Vec<Row> {
        let mut rows = vec![NO_ROW; self.vertices.len() + 1];
        for lane in 0..LANES.min(x.ncols() - first) {
            let column = x.col(first + lane);
            for (row, &v) in rows.iter_mut().zip(self.vertices) {
                for (axis, row) in row.iter_mut().enumerate() {
                    row[lane] = column[3 * v as usize + axis];
                }
            }
        }
        rows
    }
}

/// Which vector a lane of a block is paired with.
#[derive(Clone, Copy)]
enum Partner {
    /// The one so many lanes on in the same block, cyclically.
    Rotated(usize),
    /// For every lane the same of the other block.
    Same(usize),
}

impl Partner {
    /// Partner of `lane` in a block of `count`; none where the pair is another lane's already.
    fn of(self, lane: usize, count: usize) -> Option<usize> {
        match self {
            Partner::Rotated(by) => {
                (2 * by != count || lane < by || by == 0).then_some((lane + by) % count)
            }
            Partner::Same(lane) => Some(lane),
        }
    }
}

/// Components of a symmetric matrix (xx, yy, zz, yz, zx, xy): row and column of each, and where an
/// entry is among them.
const SYMMETRIC: [[usize; 2]; 6] = [[0, 0], [1, 1], [2, 2], [1, 2], [2, 0], [0, 1]];
const COMPONENT: [[usize; 3]; 3] = [[0, 5, 4], [5, 1, 3], [4, 3, 2]];

/// A 3×3 matrix by rows, and a symmetric one, for some vectors.
type Matrix<S> = [<S as Simd>::f64s; 9];
type Symmetric<S> = [<S as Simd>::f64s; 6];

// Loops, not iterator or array methods: those are not sure to be inlined into code compiled for the
// processor at hand, and cost tenfold when they are not.

/// Vector number `part` of some lanes.
#[inline(always)]
fn load<S: Simd>(lanes: &[f64], part: usize) -> S::f64s {
    S::as_simd_f64s(lanes).0[part]
}

#[inline(always)]
fn store<S: Simd>(lanes: &mut [f64], part: usize, x: S::f64s) {
    S::as_mut_simd_f64s(lanes).0[part] = x;
}

/// ∇u = Σ_a u_a ⊗ ∇N_a of lanes in vector `part`, from the rows of the four corners.
#[inline(always)]
fn gradient<S: Simd>(simd: S, element: &Element, x: &[Row], part: usize) -> Matrix<S> {
    let first = &x[element.rows[0] as usize];
    let mut d = [simd.splat_f64s(0.0); 9];
    for corner in 0..3 {
        let row = &x[element.rows[corner + 1] as usize];
        let g = &element.gradients[corner];
        for axis in 0..3 {
            let edge = simd.sub_f64s(load::<S>(&row[axis], part), load::<S>(&first[axis], part));
            for k in 0..3 {
                let entry = &mut d[3 * axis + k];
                *entry = simd.mul_add_f64s(edge, simd.splat_f64s(g[k]), *entry);
            }
        }
    }
    d
}

/// V·S(E) from 2E.
#[inline(always)]
fn second_stress<S: Simd>(simd: S, element: &Element, twice: &Symmetric<S>) -> Symmetric<S> {
    let mu = simd.splat_f64s(element.volume_mu);
    let half_lambda = simd.splat_f64s(0.5 * element.volume_lambda);
    let trace = simd.add_f64s(simd.add_f64s(twice[0], twice[1]), twice[2]);
    let pressure = simd.mul_f64s(half_lambda, trace);
    let mut s = *twice;
    for k in 0..3 {
        s[k] = simd.mul_add_f64s(mu, twice[k], pressure);
        s[k + 3] = simd.mul_f64s(mu, twice[k + 3]);
    }
    s
}

/// D + Dᵀ.
#[inline(always)]
fn twice_symmetric<S: Simd>(simd: S, d: &Matrix<S>) -> Symmetric<S> {
    let mut sum = [d[0]; 6];
    for k in 0..6 {
        let [i, j] = SYMMETRIC[k];
        sum[k] = simd.add_f64s(d[3 * i + j], d[3 * j + i]);
    }
    sum
}

/// P + A·S, S symmetric.
#[inline(always)]
fn add_product<S: Simd>(simd: S, p: &mut Matrix<S>, a: &Matrix<S>, s: &Symmetric<S>) {
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                p[3 * i + j] = simd.mul_add_f64s(a[3 * i + k], s[COMPONENT[k][j]], p[3 * i + j]);
            }
        }
    }
}

/// A symmetric matrix with both its triangles.
#[inline(always)]
fn both_triangles<S: Simd>(s: &Symmetric<S>) -> Matrix<S> {
    let mut full = [s[0]; 9];
    for k in 0..9 {
        full[k] = s[COMPONENT[k / 3][k % 3]];
    }
    full
}

/// Adds P∇N to the rows of the four corners; those of a vertex are `stride` apart.
#[inline(always)]
fn scatter<S: Simd>(
    simd: S,
    element: &Element,
    p: &Matrix<S>,
    sums: &mut [Row],
    [stride, group]: [usize; 2],
    part: usize,
) {
    let mut total = [simd.splat_f64s(0.0); 3];
    for corner in 0..3 {
        let g = &element.gradients[corner];
        let row = &mut sums[element.rows[corner + 1] as usize * stride + group];
        for axis in 0..3 {
            let mut force = simd.mul_f64s(p[3 * axis], simd.splat_f64s(g[0]));
            force = simd.mul_add_f64s(p[3 * axis + 1], simd.splat_f64s(g[1]), force);
            force = simd.mul_add_f64s(p[3 * axis + 2], simd.splat_f64s(g[2]), force);
            total[axis] = simd.add_f64s(total[axis], force);
            let sum = simd.add_f64s(load::<S>(&row[axis], part), force);
            store::<S>(&mut row[axis], part, sum);
        }
    }
    let row = &mut sums[element.rows[0] as usize * stride + group];
    for axis in 0..3 {
        let sum = simd.sub_f64s(load::<S>(&row[axis], part), total[axis]);
        store::<S>(&mut row[axis], part, sum);
    }
}

/// Internal forces, P = F S(E) as in [`crate::material::stvk::stress`].
struct Forces<'a> {
    tile: Tile<'a>,
    x: &'a [Vec<Row>],
    sums: &'a mut [Row],
}

impl WithSimd for Forces<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let n_groups = self.x.len();
        for element in self.tile.elements {
            for group in 0..n_groups {
                for part in 0..LANES / S::F64_LANES {
                    let d = gradient(simd, element, &self.x[group], part);
                    let mut twice = twice_symmetric(simd, &d);
                    for e in 0..6 {
                        let [i, j] = SYMMETRIC[e];
                        for k in 0..3 {
                            twice[e] = simd.mul_add_f64s(d[3 * k + i], d[3 * k + j], twice[e]);
                        }
                    }
                    let s = second_stress(simd, element, &twice);
                    let mut p = both_triangles::<S>(&s);
                    add_product(simd, &mut p, &d, &s);
                    scatter(simd, element, &p, self.sums, [n_groups, group], part);
                }
            }
        }
    }
}

/// D²P(0)[A, B] as in [`crate::material::stvk::stress_second_derivative_at_rest`].
struct SecondDerivatives<'a> {
    tile: Tile<'a>,
    scale: f64,
    a: &'a [Row],
    /// Rows of the other block, if there is one.
    b: Option<&'a [Row]>,
    /// Vectors in the last block.
    count: usize,
    partners: &'a [Partner],
    sums: &'a mut [Row],
}

impl WithSimd for SecondDerivatives<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let n_groups = self.partners.len();
        let mut a: Field = [[0.0; 2 * LANES]; 15];
        let mut b: Field = [[0.0; 2 * LANES]; 15];
        for element in self.tile.elements {
            let element = &Element {
                volume_lambda: self.scale * element.volume_lambda,
                volume_mu: self.scale * element.volume_mu,
                ..*element
            };
            field(simd, element, self.a, &mut a);
            match self.b {
                Some(rows) => field(simd, element, rows, &mut b),
                None => repeat(&mut a, self.count),
            }
            for group in 0..n_groups {
                for part in 0..LANES / S::F64_LANES {
                    let zero = simd.splat_f64s(0.0);
                    let (mut left, mut right) = ([zero; 15], [zero; 15]);
                    for k in 0..15 {
                        left[k] = load::<S>(&a[k], part);
                    }
                    match self.partners[group] {
                        Partner::Rotated(by) => {
                            for k in 0..15 {
                                right[k] = load::<S>(&a[k][by % LANES..], part);
                            }
                        }
                        Partner::Same(lane) => {
                            for k in 0..15 {
                                right[k] = simd.splat_f64s(b[k][lane % LANES]);
                            }
                        }
                    }
                    let p = second_derivative(simd, element, &left, &right);
                    scatter(simd, element, &p, self.sums, [n_groups, group], part);
                }
            }
        }
    }
}

/// Gradient and stress of the vectors in rows `x`.
#[inline(always)]
fn field<S: Simd>(simd: S, element: &Element, x: &[Row], field: &mut Field) {
    for part in 0..LANES / S::F64_LANES {
        let d = gradient(simd, element, x, part);
        let s = second_stress(simd, element, &twice_symmetric(simd, &d));
        for k in 0..9 {
            store::<S>(&mut field[k], part, d[k]);
        }
        for k in 0..6 {
            store::<S>(&mut field[9 + k], part, s[k]);
        }
    }
}

/// Puts the first `count` lanes behind themselves.
#[inline(always)]
fn repeat(field: &mut Field, count: usize) {
    for lanes in field {
        let mut once = [0.0; LANES];
        once.copy_from_slice(&lanes[..LANES]);
        lanes[count.min(LANES)..][..LANES].copy_from_slice(&once);
    }
}

/// V·(A S(sym B) + B S(sym A) + S(sym(AᵀB))) from gradients and stresses.
#[inline(always)]
fn second_derivative<S: Simd>(
    simd: S,
    element: &Element,
    left: &[S::f64s; 15],
    right: &[S::f64s; 15],
) -> Matrix<S> {
    let ([a @ .., _, _, _, _, _, _], [b @ .., _, _, _, _, _, _]) = (left, right);
    let ([_, _, _, _, _, _, _, _, _, sa @ ..], [_, _, _, _, _, _, _, _, _, sb @ ..]) =
        (left, right);
    let mut twice = [a[0]; 6];
    for e in 0..6 {
        let [i, j] = SYMMETRIC[e];
        let mut sum = simd.mul_f64s(a[i], b[j]);
        for k in 1..3 {
            sum = simd.mul_add_f64s(a[3 * k + i], b[3 * k + j], sum);
        }
        if i == j {
            sum = simd.add_f64s(sum, sum);
        } else {
            for k in 0..3 {
                sum = simd.mul_add_f64s(a[3 * k + j], b[3 * k + i], sum);
            }
        }
        twice[e] = sum;
    }
    let mut p = both_triangles::<S>(&second_stress(simd, element, &twice));
    add_product(simd, &mut p, a, sb);
    add_product(simd, &mut p, b, sa);
    p
}
