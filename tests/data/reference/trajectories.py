"""Full-order motion of a small stitched bar for every material law: writes trajectories.json.

An oracle that shares nothing with the project's code: energies are written down from the literature (see
the docstrings in src/reduced/material), and forces and stiffness follow by automatic differentiation.
The bar's halves are stitched by springs; one end is held; gravity acts from the start and a pull at a
corner of the tip for PULLED_S seconds. Newmark (average acceleration) with a quarter of the step that the
tests take.

    pip install jax==0.10.2 numpy==2.4.6
    python tests/data/reference/trajectories.py
"""

import itertools
import json
import pathlib

import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)

CELLS, EDGE_M = (4, 2, 2), 0.025
YOUNG_PA, POISSON, DENSITY, MOONEY_RATIO = 5e5, 0.4, 1000.0, 0.3
STITCH_N_M = 1e4
MASS_PER_S, STIFFNESS_S = 0.5, 2e-4
GRAVITY_M_S2 = (0.0, -9.81, 0.0)
PULL_N, PULLED_S = (0.0, 0.1, 0.4), 0.1
DT_S, SAMPLE_S, DURATION_S = 2.5e-4, 4e-3, 0.6

MU = YOUNG_PA / (2 * (1 + POISSON))
LAMBDA = YOUNG_PA * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
EYE = jnp.eye(3)


def bar():
    """Two halves of CELLS cells of six tets each (Kuhn), which meet at x = CELLS[0]·EDGE_M."""
    nx, ny, nz = CELLS
    vertices, tets = [], []
    for half in range(2):
        first = len(vertices)
        for k, j, i in itertools.product(range(nz + 1), range(ny + 1), range(nx + 1)):
            vertices.append([(i + half * nx) * EDGE_M, j * EDGE_M, k * EDGE_M])
        index = lambda p: first + p[0] + (nx + 1) * (p[1] + (ny + 1) * p[2])
        for corner in itertools.product(range(nx), range(ny), range(nz)):
            for order in itertools.permutations(range(3)):
                place, tet = list(corner), [index(corner)]
                for axis in order:
                    place[axis] += 1
                    tet.append(index(place))
                edges = np.array([np.subtract(vertices[v], vertices[tet[0]]) for v in tet[1:]])
                tets.append(tet if np.linalg.det(edges) > 0 else [tet[0], tet[1], tet[3], tet[2]])
    n = len(vertices) // 2
    rows = range(0, n, nx + 1)
    pairs = [[row + nx, n + row] for row in rows]
    root = list(rows)
    return np.array(vertices), np.array(tets), pairs, root


def linear(f):
    strain = 0.5 * (f + f.T) - EYE
    return MU * jnp.sum(strain**2) + 0.5 * LAMBDA * jnp.trace(strain) ** 2


def stvk(f):
    strain = 0.5 * (f.T @ f - EYE)
    return MU * jnp.sum(strain**2) + 0.5 * LAMBDA * jnp.trace(strain) ** 2


def neo_hookean(f):
    """Smith, De Goes and Kim (2018), eq. 14."""
    mu, lam = 4 / 3 * MU, LAMBDA + 5 / 6 * MU
    alpha = 1 + 3 * mu / (4 * lam)
    i_c = jnp.sum(f * f)
    return 0.5 * mu * (i_c - 3 - jnp.log(i_c + 1)) + 0.5 * lam * (jnp.linalg.det(f) - alpha) ** 2


def mooney_rivlin(f):
    c01 = 0.5 * MU * MOONEY_RATIO
    c10 = 0.5 * MU - c01
    c = f.T @ f
    i_c, j = jnp.trace(c), jnp.linalg.det(f)
    ii_c = 0.5 * (i_c**2 - jnp.trace(c @ c))
    d, bulk = 2 * c10 + 4 * c01, LAMBDA + 2 * c10
    return c10 * (i_c - 3) + c01 * (ii_c - 3) - d * (j - 1) + 0.5 * bulk * (j - 1) ** 2


def corotational(f):
    """The rotation by Newton's iteration (Higham 1986), differentiated as it stands."""
    r = f
    for _ in range(5):
        cofactor = jnp.stack([jnp.cross(r[1], r[2]), jnp.cross(r[2], r[0]), jnp.cross(r[0], r[1])])
        r = 0.5 * (r + cofactor / jnp.dot(r[0], cofactor[0]))
    return MU * jnp.sum((f - r) ** 2) + 0.5 * LAMBDA * (jnp.trace(r.T @ f) - 3) ** 2


LAWS = [linear, stvk, neo_hookean, mooney_rivlin, corotational]


def trajectory(density, vertices, tets, pairs, root):
    """Displacement of the tip's last vertex and energies in J, every SAMPLE_S."""
    x = jnp.asarray(vertices)
    rest = jnp.swapaxes(x[tets[:, 1:]] - x[tets[:, :1]], 1, 2)
    to_rest, volumes = jnp.linalg.inv(rest), jnp.linalg.det(rest) / 6
    free = np.setdiff1d(np.arange(len(vertices)), root)
    dofs = (3 * free[:, None] + np.arange(3)).ravel()
    masses = np.zeros(len(vertices))
    np.add.at(masses, tets.ravel(), np.repeat(np.asarray(volumes) * DENSITY / 4, 4))
    mass = np.repeat(masses, 3)[dofs]
    a, b = np.array(pairs).T

    n, n_all = len(dofs), 3 * len(vertices)
    element_dofs = (3 * tets[:, :, None] + np.arange(3)).reshape(len(tets), 12)
    stitches = np.zeros((n_all, n_all))
    for i, j in zip(a, b):
        for axis in range(3):
            p, q = 3 * i + axis, 3 * j + axis
            stitches[p, p] += STITCH_N_M
            stitches[q, q] += STITCH_N_M
            stitches[p, q] -= STITCH_N_M
            stitches[q, p] -= STITCH_N_M

    def element(u, corners, inverse, volume):
        y = corners + u.reshape(4, 3)
        f = (y[1:] - y[0]).T @ inverse
        return volume * (density(f) - density(EYE))

    args = (x[tets], to_rest, volumes)
    energies = jax.jit(jax.vmap(element))
    forces = jax.jit(jax.vmap(jax.grad(element)))
    stiffness = jax.jit(jax.vmap(jax.hessian(element)))

    def whole(u_free):
        u = np.zeros(n_all)
        u[dofs] = u_free
        return u

    def energy(u_free):
        u = whole(u_free)
        return float(energies(u[element_dofs], *args).sum()) + 0.5 * u @ stitches @ u

    def force(u_free):
        u = whole(u_free)
        f = stitches @ u
        np.add.at(f, element_dofs, np.asarray(forces(u[element_dofs], *args)))
        return f[dofs]

    def tangent(u_free):
        k = stitches.copy()
        at = (element_dofs[:, :, None], element_dofs[:, None, :])
        np.add.at(k, at, np.asarray(stiffness(whole(u_free)[element_dofs], *args)))
        return k[np.ix_(dofs, dofs)]

    zero = np.zeros(n)
    weight = (masses[:, None] * np.array(GRAVITY_M_S2)).ravel()[dofs]
    damping = np.diag(MASS_PER_S * mass) + STIFFNESS_S * tangent(zero)
    tip = len(vertices) - 1
    pull = np.zeros(3 * len(vertices))
    pull[3 * tip : 3 * tip + 3] = PULL_N
    pull = pull[dofs]

    q, v = np.zeros(n), np.zeros(n)
    samples = []
    every = round(SAMPLE_S / DT_S)
    for step in range(round(DURATION_S / DT_S)):
        load = weight + (pull if step * DT_S < PULLED_S - 1e-9 else 0)
        acceleration = (load - damping @ v - force(q)) / mass
        p = q.copy()
        for _ in range(30):
            new_v = 2 / DT_S * (p - q) - v
            new_a = 4 / DT_S**2 * (p - q - DT_S * v) - acceleration
            f = force(p)
            residual = load - mass * new_a - damping @ new_v - f
            if np.linalg.norm(residual) < 1e-9 * np.linalg.norm(f):
                break
            k = tangent(p) + 2 / DT_S * damping + np.diag(4 / DT_S**2 * mass)
            p = p + np.linalg.solve(k, residual)
        else:
            raise SystemExit("Newton's method does not converge")
        q, v = p, new_v
        if (step + 1) % every == 0:
            at = np.searchsorted(free, tip)
            kinetic = 0.5 * float(mass @ v**2)
            samples.append([*q[3 * at : 3 * at + 3], kinetic, energy(q)])
    return np.array(samples)


def main():
    vertices, tets, pairs, root = bar()
    out = {
        "vertices_m": vertices.round(6).tolist(),
        "tets": tets.tolist(),
        "pairs": pairs,
        "fixed_vertices": root,
        "young_modulus_pa": YOUNG_PA,
        "poisson_ratio": POISSON,
        "density_kg_m3": DENSITY,
        "mooney_ratio": MOONEY_RATIO,
        "stitch_n_m": STITCH_N_M,
        "damping": [MASS_PER_S, STIFFNESS_S],
        "gravity_m_s2": GRAVITY_M_S2,
        "pull_n": PULL_N,
        "pulled_s": PULLED_S,
        "sample_s": SAMPLE_S,
        "laws": {},
    }
    for law in LAWS:
        samples = trajectory(law, vertices, tets, pairs, root)
        print(law.__name__, "reaches", np.abs(samples).max(axis=0))
        rounded = [[float(f"{x:.6g}") for x in row] for row in samples.T]
        names = ["x_m", "y_m", "z_m", "kinetic_j", "potential_j"]
        out["laws"][law.__name__] = dict(zip(names, rounded))
    path = pathlib.Path(__file__).with_name("trajectories.json")
    path.write_text(json.dumps(out, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
