//! Non-negative least squares, min ‖Ax − b‖ with x ≥ 0, from the Gram matrix AᵀA
//! (Lawson–Hanson's active set in the normal-equation form of Bro and de Jong 1997), with a limit on
//! the number of positive entries: then it is the greedy selection of An et al. 2008.

use crate::linalg::SmallCholesky;
use faer::{Mat, MatRef};

/// The result of [`solve`].
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// Indices of positive entries, ascending.
    pub support: Vec<usize>,
    /// Their values.
    pub values: Vec<f64>,
    /// ‖Ax − b‖²/‖b‖².
    pub relative_residual: f64,
}

/// `gram` = AᵀA (m×m), `projection` = Aᵀb, `norm_squared` = bᵀb. Stops at `most` positive entries or
/// when ‖Ax − b‖² ≤ `tolerance`²·‖b‖². `start` (m non-negative numbers) is where to begin: zeros, or
/// a good guess, which saves most of the steps.
pub fn solve(
    gram: MatRef<'_, f64>,
    projection: &[f64],
    norm_squared: f64,
    most: usize,
    tolerance: f64,
    start: &[f64],
) -> Solution {
    let m = projection.len();
    let mut x = start.to_vec();
    let mut support: Vec<usize> = (0..m).filter(|&i| start[i] > 0.0).collect();
    let mut banned = vec![false; m];
    // Columns are compared by angle: the gain of column i is its gradient over its length.
    let length: Vec<f64> = (0..m).map(|i| gram[(i, i)].max(0.0).sqrt()).collect();
    if !support.is_empty() && settle(gram, projection, &mut support, &mut x).is_none() {
        x = vec![0.0; m];
        support.clear();
    }
    let mut residual = residual_squared(gram, projection, norm_squared, &support, &x);
    while support.len() < most && residual > tolerance * tolerance * norm_squared {
        let gradient =
            |i: usize| projection[i] - support.iter().map(|&j| gram[(i, j)] * x[j]).sum::<f64>();
        let best = (0..m)
            .filter(|&i| !banned[i] && length[i] > 0.0 && !support.contains(&i))
            .map(|i| (i, gradient(i) / length[i]))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((entering, gain)) = best else { break };
        if gain <= 1e-12 * norm_squared.sqrt() {
            break;
        }
        let (old_x, old_support) = (x.clone(), support.clone());
        support.push(entering);
        if settle(gram, projection, &mut support, &mut x).is_none() {
            (x, support) = (old_x, old_support);
            banned[entering] = true;
            continue;
        }
        let now = residual_squared(gram, projection, norm_squared, &support, &x);
        if now < residual {
            residual = now;
            banned.iter_mut().for_each(|b| *b = false);
        } else {
            // Rounding: the column adds nothing that the support lacks.
            (x, support) = (old_x, old_support);
            banned[entering] = true;
        }
    }
    support.sort_unstable();
    Solution {
        values: support.iter().map(|&i| x[i]).collect(),
        support,
        relative_residual: if norm_squared > 0.0 { residual / norm_squared } else { 0.0 },
    }
}

/// Solves on the support, stepping back along the segment and dropping entries while any would be
/// negative. `None` if the support is dependent.
fn settle(
    gram: MatRef<'_, f64>,
    projection: &[f64],
    support: &mut Vec<usize>,
    x: &mut [f64],
) -> Option<()> {
    loop {
        let k = support.len();
        let g = Mat::from_fn(k, k, |i, j| gram[(support[i], support[j])]);
        let rhs = Mat::from_fn(k, 1, |i, _| projection[support[i]]);
        let s = SmallCholesky::new(g.as_ref()).ok()?.solve(rhs.as_ref());
        if (0..k).any(|i| !s[(i, 0)].is_finite()) {
            return None;
        }
        if (0..k).all(|i| s[(i, 0)] > 0.0) {
            for (i, &index) in support.iter().enumerate() {
                x[index] = s[(i, 0)];
            }
            return Some(());
        }
        let step = (0..k)
            .filter(|&i| s[(i, 0)] <= 0.0)
            .map(|i| x[support[i]] / (x[support[i]] - s[(i, 0)]))
            .fold(1.0, f64::min);
        let before = support.len();
        for (i, &index) in support.iter().enumerate() {
            x[index] += step * (s[(i, 0)] - x[index]);
        }
        let largest = support.iter().map(|&i| x[i]).fold(0.0, f64::max);
        support.retain(|&i| {
            let keep = x[i] > 1e-14 * largest;
            if !keep {
                x[i] = 0.0;
            }
            keep
        });
        if support.len() == before || support.is_empty() {
            return None;
        }
    }
}

fn residual_squared(
    gram: MatRef<'_, f64>,
    projection: &[f64],
    norm_squared: f64,
    support: &[usize],
    x: &[f64],
) -> f64 {
    let mut value = norm_squared;
    for &i in support {
        let gx: f64 = support.iter().map(|&j| gram[(i, j)] * x[j]).sum();
        value += x[i] * (gx - 2.0 * projection[i]);
    }
    value.max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg;

    fn problem(rows: usize, columns: usize, truth: &[(usize, f64)]) -> (Mat<f64>, Vec<f64>, f64) {
        // A hash, not a sine: sines of sums have rank two.
        let a = Mat::from_fn(rows, columns, |i, j| {
            let mut h = ((i << 16 | j) as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            h = (h ^ (h >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            h ^= h >> 32;
            (h >> 40) as f64 / (1u64 << 24) as f64 - 0.3
        });
        let b = Mat::from_fn(rows, 1, |i, _| truth.iter().map(|&(j, w)| w * a[(i, j)]).sum());
        let p = linalg::gram(a.as_ref(), b.as_ref());
        let projection = (0..columns).map(|j| p[(j, 0)]).collect();
        (
            linalg::gram(a.as_ref(), a.as_ref()),
            projection,
            linalg::gram(b.as_ref(), b.as_ref())[(0, 0)],
        )
    }

    #[test]
    fn recovers_a_non_negative_combination() {
        let truth = [(3, 2.0), (11, 0.5), (25, 1.25)];
        let (g, p, n) = problem(60, 40, &truth);
        let solution = solve(g.as_ref(), &p, n, 40, 1e-10, &[0.0; 40]);
        for (j, w) in truth {
            let at = solution.support.iter().position(|&i| i == j).expect("in the support");
            assert!((solution.values[at] - w).abs() < 1e-6, "{solution:?}");
        }
        assert!(solution.values.iter().all(|v| *v > 0.0));
    }

    #[test]
    fn meets_the_optimality_conditions_where_the_unconstrained_answer_is_negative() {
        let (g, p, n) = problem(60, 12, &[(1, 1.0), (5, -0.7), (9, 0.4)]);
        for start in [[0.0; 12], [0.3; 12]] {
            let solution = solve(g.as_ref(), &p, n, 12, 0.0, &start);
            let mut x = [0.0; 12];
            for (i, v) in solution.support.iter().zip(&solution.values) {
                x[*i] = *v;
            }
            for i in 0..12 {
                let gradient = p[i] - (0..12).map(|j| g[(i, j)] * x[j]).sum::<f64>();
                let scale = 1e-9 * n.sqrt() * g[(i, i)].sqrt();
                assert!(gradient <= scale, "entry {i} could grow: {gradient}");
                assert!(x[i] == 0.0 || gradient.abs() <= scale);
            }
        }
    }

    #[test]
    fn respects_the_limit() {
        let (g, p, n) = problem(60, 40, &[(3, 2.0), (11, 0.5), (25, 1.25)]);
        assert!(solve(g.as_ref(), &p, n, 2, 0.0, &[0.0; 40]).support.len() <= 2);
    }
}
