//! The tensor cross product of 3×3 matrices (Bonet, Gil and Ortigosa, *Comput. Methods Appl. Mech.
//! Engrg.* 283, 2015): (A ⨯ B)_ij = ε_ikm ε_jln A_kl B_mn. cof F = ½ F ⨯ F, and the derivative of cof at F along H
//! is F ⨯ H.

use super::{Mat3, Mat9};

/// A ⨯ B.
pub(super) fn cross(a: &Mat3, b: &Mat3) -> Mat3 {
    Mat3::from_fn(|i, j| {
        let ([k, m], [l, n]) = (others(i), others(j));
        a[(k, l)] * b[(m, n)] - a[(k, n)] * b[(m, l)] - a[(m, l)] * b[(k, n)]
            + a[(m, n)] * b[(k, l)]
    })
}

/// The two indices that follow `i` in cyclic order.
fn others(i: usize) -> [usize; 2] {
    [(i + 1) % 3, (i + 2) % 3]
}

/// cof A: the matrix of cofactors.
pub(super) fn cofactor(a: &Mat3) -> Mat3 {
    cross(a, a) * 0.5
}

/// cof(I + D) − I = tr(D) I − Dᵀ + cof D, without cancellation.
pub(super) fn cofactor_change(d: &Mat3) -> Mat3 {
    Mat3::identity() * d.trace() - d.transpose() + cofactor(d)
}

/// det(I + D) − 1 = tr D + tr cof D + det D, without cancellation.
pub(super) fn volume_change(d: &Mat3) -> f64 {
    d.trace() + cofactor(d).trace() + d.determinant()
}

/// H ↦ A ⨯ H as a 9×9 matrix (symmetric).
pub(super) fn cross_matrix(a: &Mat3) -> Mat9 {
    let mut out = [[0.0; 9]; 9];
    for i in 0..3 {
        for j in 0..3 {
            let ([k, m], [l, n]) = (others(i), others(j));
            let row = &mut out[3 * i + j];
            row[3 * m + n] = a[(k, l)];
            row[3 * m + l] = -a[(k, n)];
            row[3 * k + n] = -a[(m, l)];
            row[3 * k + l] = a[(m, n)];
        }
    }
    out
}

/// Entries of `a` by rows.
pub(super) fn entries(a: &Mat3) -> [f64; 9] {
    std::array::from_fn(|k| a[(k / 3, k % 3)])
}

/// Adds s·a bᵀ.
pub(super) fn add_dyad(to: &mut Mat9, s: f64, a: &Mat3, b: &Mat3) {
    let (a, b) = (entries(a), entries(b));
    for (row, a) in to.iter_mut().zip(a) {
        for (entry, b) in row.iter_mut().zip(b) {
            *entry += s * a * b;
        }
    }
}

/// Adds s·B.
pub(super) fn add_scaled(to: &mut Mat9, s: f64, b: &Mat9) {
    for (row, b) in to.iter_mut().zip(b) {
        for (entry, b) in row.iter_mut().zip(b) {
            *entry += s * b;
        }
    }
}

/// s·I.
pub(super) fn diagonal(s: f64) -> Mat9 {
    std::array::from_fn(|i| std::array::from_fn(|j| if i == j { s } else { 0.0 }))
}
