"""A whole session build assembled from NumPy, SciPy and Pardiso: the same steps and sizes as ours.

30 modes, the 36 derivatives of the 8 lowest, 60 columns by mass-PCA with the weights λ₁/λ_i and
λ₁²/(λ_iλ_j) (Barbič 2012, eq. 18), 120 cubature points chosen from 1440 random tets to fit the reduced
forces of 100 poses (An et al. 2008, as non-negative least squares), their error on 20 others.
"""

import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import scipy.linalg

from fem import Model, product, second_stress

N_MODES, N_DERIVATIVE_MODES, BASIS_SIZE = 30, 8, 60
N_POINTS, N_CANDIDATES, N_POSES, N_HELD_OUT = 120, 1440, 100, 20


def measure(body, make_solver, lowest_modes, shifted, repeat, threads):
    """Seconds of every repetition and the medians of the stages."""
    totals, stages = [], {}
    for _ in range(repeat):
        with ThreadPoolExecutor(threads) as pool:
            found, error, n_points = build(body, make_solver, lowest_modes, shifted, pool)
        totals.append(sum(found.values()))
        for stage, seconds in found.items():
            stages.setdefault(stage, []).append(seconds)
    return {
        "seconds": totals,
        "stages_s": {stage: float(np.median(seconds)) for stage, seconds in stages.items()},
        "cubature_error": error,
        "n_cubature_points": n_points,
    }


def build(body, make_solver, lowest_modes, shifted, pool):
    """One build of a body that is held: seconds by stage, the cubature's error and its points."""
    clock = time.perf_counter
    stages, last = {}, clock()

    def done(stage):
        nonlocal last
        stages[stage], last = clock() - last, clock()

    model = Model(body)
    done("assembly")
    solver = make_solver(shifted(model, 0.0))
    solver.analyse()
    solver.factorize()
    done("factorization")
    values, modes = lowest_modes(model, 0.0, solver, N_MODES)
    done("modes")
    loads, pairs = model.derivative_loads(modes[:, :N_DERIVATIVE_MODES], pool)
    derivatives = solver.solve(np.asfortranarray(loads))
    solver.free()
    done("derivatives")
    basis = principal_components(model, values, modes, derivatives, pairs)
    done("basis")
    error, n_points = cubature(model, body, basis, values, modes, derivatives, pairs, pool)
    done("cubature")
    return stages, error, n_points


def principal_components(model, values, modes, derivatives, pairs):
    """The leading left singular vectors of √M·[modes, derivatives], weighed, over √M."""
    root = np.sqrt(model.mass)[:, None]
    columns = root * np.concatenate([modes, derivatives], axis=1)
    pair = np.array(pairs)
    weights = np.concatenate([values[0] / values, values[0] ** 2 / (values[pair].prod(axis=1))])
    columns *= weights / np.linalg.norm(columns, axis=0)
    left, _, _ = scipy.linalg.svd(columns, full_matrices=False, overwrite_a=True, check_finite=False)
    return left[:, :BASIS_SIZE] / root


def poses(body, values, modes, derivatives, pairs, count, seed):
    """Random points of the quadratic manifold, 2 to 12 % of the body's diagonal."""
    random = np.random.default_rng(seed)
    decay = random.uniform(0.5, 1.0, count)
    linear = random.standard_normal((len(values), count)) * (values[0] / values)[:, None] ** decay
    largest = lambda u: np.sqrt((u.reshape(-1, 3, count) ** 2).sum(axis=1).max(axis=0))
    u = modes @ linear
    scale = random.uniform(0.02, 0.12, count) * body.diagonal / largest(u)
    u *= scale
    i, j = np.array(pairs).T
    quadratic = linear[i] * linear[j] * np.where(i == j, 0.5, 1.0)[:, None] * scale**2
    bent = derivatives @ quadratic
    u += bent * np.minimum(1.0, largest(u) / largest(bent))
    return u


def cubature(model, body, basis, values, modes, derivatives, pairs, pool):
    """Trains a rule; its relative force error on held-out poses."""
    random = np.random.default_rng(2)
    m = len(model.volume)
    candidates = np.sort(random.choice(m, min(N_CANDIDATES, m), replace=False))
    samples = lambda count, seed: Samples(
        model, basis, poses(body, values, modes, derivatives, pairs, count, seed), pool
    )
    training = samples(N_POSES, 3)
    columns = training.contributions(candidates)
    target = training.target()
    gram = scipy.linalg.blas.dsyrk(1.0, columns, trans=1)
    gram = np.triu(gram) + np.triu(gram, 1).T
    chosen, weights = nonnegative(gram, columns.T @ target)
    held_out = samples(N_HELD_OUT, 4)
    difference = held_out.contributions(candidates[chosen]) @ weights - held_out.target()
    return float(np.sqrt((difference**2).sum() / N_HELD_OUT)), len(chosen)


class Samples:
    """Projected poses and their exact reduced forces, each scaled to length one."""

    def __init__(self, model, basis, u, pool):
        self.model, self.basis = model, basis
        self.u = basis @ (basis.T @ (model.mass[:, None] * u))
        full = np.stack(list(pool.map(model.internal_force, self.u.T)), axis=1)
        self.force = basis.T @ full
        self.scale = 1 / np.linalg.norm(self.force, axis=0)

    def target(self):
        return (self.force * self.scale).T.ravel()

    def contributions(self, tets):
        """A column for each tet: its shares of every pose's reduced force, (poses·r) × tets."""
        model, k, r = self.model, self.u.shape[1], self.basis.shape[1]
        m, p = len(model.volume), len(tets)
        rows = (np.arange(9)[:, None] * m + tets).ravel()
        operator = model.operator[rows]
        gradients = (operator @ self.basis).reshape(9, p, r)
        a = (operator @ self.u).reshape(3, 3, p * k)
        lam, mu = (np.repeat(c[tets], k) for c in model.lame)
        strain = 0.5 * (a + a.transpose(1, 0, 2) + product(a.transpose(1, 0, 2), a))
        s = second_stress(strain, lam, mu)
        stress = (s + product(a, s)).reshape(9, p, k) * model.volume[tets][:, None] * self.scale
        # One (k × 9)·(9 × r) product for each tet.
        shares = np.matmul(stress.transpose(1, 2, 0), gradients.transpose(1, 0, 2))
        return shares.reshape(p, k * r).T


def nonnegative(gram, projection):
    """Lawson–Hanson on the normal equations, at most N_POINTS points."""
    n = len(projection)
    support, x = [], np.zeros(n)
    while len(support) < N_POINTS:
        slope = projection - gram[:, support] @ x[support]
        slope[support] = -np.inf
        best = int(np.argmax(slope))
        if slope[best] <= 0:
            break
        support.append(best)
        while True:
            factor = scipy.linalg.cho_factor(gram[np.ix_(support, support)], check_finite=False)
            solution = scipy.linalg.cho_solve(factor, projection[support], check_finite=False)
            if (solution > 0).all():
                x[support] = solution
                break
            old = x[support]
            falling = solution <= 0
            step = (old[falling] / (old[falling] - solution[falling])).min()
            x[support] = old + step * (solution - old)
            gone = [s for s in support if x[s] <= 1e-14 * x.max()]
            if not gone:
                gone = [support[int(np.argmin(solution))]]
            x[gone] = 0
            support = [s for s in support if s not in gone]
    support.sort()
    return np.array(support), x[support]
