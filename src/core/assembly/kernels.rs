//! The arithmetic of one tet for eight vectors, or pairs of vectors, at a time.

use super::tiles::{Element, LANES, Partner, Row, Tile};
use crate::material::{Elasticity, Hyperelastic, Law, Mat3};
use pulp::{Simd, WithSimd};

/// Displacement gradient (by rows) and symmetric stress (xx, yy, zz, yz, zx, xy) of [`LANES`] vectors at
/// one tet, each twice in a row where lanes are to be rotated.
type Field = [[f64; 2 * LANES]; 15];

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

/// Internal forces: P = F S(E) of [`crate::material::stvk`] by lanes, other laws one lane after the other.
pub(super) struct Forces<'a> {
    pub(super) tile: Tile<'a>,
    /// Tet by tet of the mesh.
    pub(super) elasticities: &'a [Elasticity],
    pub(super) volumes_m3: &'a [f64],
    pub(super) x: &'a [Vec<Row>],
    pub(super) sums: &'a mut [Row],
}

impl WithSimd for Forces<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let n_groups = self.x.len();
        for element in self.tile.elements {
            if element.law != Law::StVenantKirchhoff {
                let tet = element.tet as usize;
                let (elasticity, volume_m3) = (&self.elasticities[tet], self.volumes_m3[tet]);
                for group in 0..n_groups {
                    let mut p = [[0.0; LANES]; 9];
                    for part in 0..LANES / S::F64_LANES {
                        let d = gradient(simd, element, &self.x[group], part);
                        for k in 0..9 {
                            store::<S>(&mut p[k], part, d[k]);
                        }
                    }
                    stresses(elasticity, volume_m3, &mut p);
                    for part in 0..LANES / S::F64_LANES {
                        let mut lanes = [simd.splat_f64s(0.0); 9];
                        for k in 0..9 {
                            lanes[k] = load::<S>(&p[k], part);
                        }
                        scatter(simd, element, &lanes, self.sums, [n_groups, group], part);
                    }
                }
                continue;
            }
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

/// V·P in place of the displacement gradients of some lanes.
pub(crate) fn stresses<const N: usize>(
    elasticity: &Elasticity,
    volume_m3: f64,
    lanes: &mut [[f64; N]; 9],
) {
    for lane in 0..N {
        let d = Mat3::from_fn(|i, j| lanes[3 * i + j][lane]);
        let p = elasticity.stress(&d) * volume_m3;
        for (k, entry) in lanes.iter_mut().enumerate() {
            entry[lane] = p[(k / 3, k % 3)];
        }
    }
}

/// D²P(0)[A, B] as in [`crate::material::AtRest::stress_second_derivative`].
pub(super) struct SecondDerivatives<'a> {
    pub(super) tile: Tile<'a>,
    pub(super) scale: f64,
    pub(super) a: &'a [Row],
    /// Rows of the other block, if there is one.
    pub(super) b: Option<&'a [Row]>,
    /// Vectors in the last block.
    pub(super) count: usize,
    pub(super) partners: &'a [Partner],
    pub(super) sums: &'a mut [Row],
}

impl WithSimd for SecondDerivatives<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let n_groups = self.partners.len();
        let mut a: Field = [[0.0; 2 * LANES]; 15];
        let mut b: Field = [[0.0; 2 * LANES]; 15];
        for element in self.tile.elements {
            if element.law == Law::Linear {
                continue;
            }
            let [cubic, mixed, product] = element.third_order;
            let third_order = [self.scale * cubic, self.scale * mixed, self.scale * product];
            let element = &Element {
                volume_lambda: self.scale * element.volume_lambda,
                volume_mu: self.scale * element.volume_mu,
                third_order,
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
                    let mut p = second_derivative(simd, element, &left, &right);
                    if element.law != Law::StVenantKirchhoff {
                        add_third_order(simd, element, &left, &right, &mut p);
                    }
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

/// Adds V·(2a tr A tr B I + 2b (tr(AB) I + tr(A) B + tr(B) A) + c (AB + BA)), A and B being the symmetric parts of
/// the gradients.
#[inline(always)]
fn add_third_order<S: Simd>(
    simd: S,
    element: &Element,
    left: &[S::f64s; 15],
    right: &[S::f64s; 15],
    p: &mut Matrix<S>,
) {
    let ([a @ .., _, _, _, _, _, _], [b @ .., _, _, _, _, _, _]) = (left, right);
    let (a, b) = (twice_symmetric(simd, a), twice_symmetric(simd, b));
    // Both are twice the strain: a quarter of every product.
    let [cubic, mixed, product] = element.third_order;
    let half_cubic = simd.splat_f64s(0.5 * cubic);
    let half_mixed = simd.splat_f64s(0.5 * mixed);
    let quarter_product = simd.splat_f64s(0.25 * product);
    let trace_a = simd.add_f64s(simd.add_f64s(a[0], a[1]), a[2]);
    let trace_b = simd.add_f64s(simd.add_f64s(b[0], b[1]), b[2]);
    let zero = simd.splat_f64s(0.0);
    let mut both = [zero; 9];
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                both[3 * i + j] =
                    simd.mul_add_f64s(a[COMPONENT[i][k]], b[COMPONENT[k][j]], both[3 * i + j]);
            }
        }
    }
    let trace_both = simd.add_f64s(simd.add_f64s(both[0], both[4]), both[8]);
    let isotropic = simd.mul_add_f64s(
        half_cubic,
        simd.mul_f64s(trace_a, trace_b),
        simd.mul_f64s(half_mixed, trace_both),
    );
    let (scaled_a, scaled_b) =
        (simd.mul_f64s(half_mixed, trace_b), simd.mul_f64s(half_mixed, trace_a));
    for i in 0..3 {
        for j in 0..3 {
            let at = COMPONENT[i][j];
            let mut sum = simd.mul_f64s(scaled_a, a[at]);
            sum = simd.mul_add_f64s(scaled_b, b[at], sum);
            let pair = simd.add_f64s(both[3 * i + j], both[3 * j + i]);
            sum = simd.mul_add_f64s(quarter_product, pair, sum);
            if i == j {
                sum = simd.add_f64s(sum, isotropic);
            }
            p[3 * i + j] = simd.add_f64s(p[3 * i + j], sum);
        }
    }
}
