"""Bodies of linear tetrahedra with NumPy and SciPy: the matrices and forces that both sides share.

Fields are kept by components, each a contiguous array over the tets: NumPy is at its fastest so.
"""

import json
import os

import numpy as np
import scipy.sparse as sp


class Body:
    """A Gmsh 2.2 mesh in text, its materials and supports."""

    def __init__(self, folder, name):
        with open(os.path.join(folder, f"{name}.json")) as file:
            config = json.load(file)
        self.name = name
        self.vertices, self.tets, labels = read_gmsh(os.path.join(folder, f"{name}.msh"))
        young, poisson, density = np.array([material(config, label) for label in labels.tolist()]).T
        self.lame_lambda = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
        self.lame_mu = young / (2 * (1 + poisson))
        self.density = density
        fixed = config.get("fixed_vertices", config.get("fixed"))
        free = np.setdiff1d(np.arange(len(self.vertices)), fixed)
        self.free_dofs = (3 * free[:, None] + np.arange(3)).ravel()
        self.fixed = np.asarray(fixed, dtype=int)
        self.diagonal = np.linalg.norm(np.ptp(self.vertices, axis=0))

    def n_rigid_modes(self):
        """Six for each piece that nothing holds."""
        n = len(self.vertices)
        edges = np.concatenate([self.tets[:, [0, i]] for i in (1, 2, 3)])
        graph = sp.coo_matrix((np.ones(len(edges)), edges.T), shape=(n, n))
        count, piece = sp.csgraph.connected_components(graph, directed=False)
        used = np.unique(piece[np.unique(self.tets)])
        return 6 * len(np.setdiff1d(used, piece[self.fixed]))


def material(config, label):
    """Young's modulus, Poisson's ratio and density of a domain."""
    if "domain_materials" in config:
        m = config["domain_materials"][str(label)]
        return m["young_modulus_pa"], m["poisson_ratio"], m["density_kg_m3"]
    m = config["suggested_materials"][label - 1]
    return m["young_Pa"], m["poisson"], m["density"]


def read_gmsh(path):
    """Vertices, tets (zero-based) and physical tags."""
    with open(path) as file:
        lines = file.read().split("\n")
    at = {line: i for i, line in enumerate(lines) if line.startswith("$")}
    if not lines[at["$MeshFormat"] + 1].startswith("2.2 0"):
        raise ValueError(f"{path}: only Gmsh 2.2 in text is read here")
    block = lambda name: lines[at[f"${name}"] + 2 : at[f"$End{name}"]]
    nodes = np.array([line.split() for line in block("Nodes")], dtype=float)
    index = np.empty(int(nodes[:, 0].max()) + 1, dtype=np.int32)
    index[nodes[:, 0].astype(int)] = np.arange(len(nodes))
    rows = [line.split() for line in block("Elements")]
    tets = np.array([[row[3], *row[-4:]] for row in rows if row[1] == "4"], dtype=int)
    return nodes[:, 1:4], index[tets[:, 1:]], tets[:, 0]


class Model:
    """Mass, stiffness and the gradient operator over the free degrees of freedom."""

    def __init__(self, body):
        x = body.vertices[body.tets]
        edges = np.stack([x[:, i] - x[:, 0] for i in (1, 2, 3)], axis=2)
        inverse = np.linalg.inv(edges)
        gradients = np.concatenate([-inverse.sum(1, keepdims=True), inverse], axis=1)
        self.volume = np.linalg.det(edges) / 6
        self.lame = body.lame_lambda, body.lame_mu
        m, n = len(body.tets), len(body.vertices)

        outer = np.einsum("mai,mbj->mabij", gradients, gradients)
        dots = np.einsum("mabkk->mab", outer)
        lam, mu = (c[:, None, None, None, None] for c in self.lame)
        blocks = lam * outer + mu * (outer.transpose(0, 1, 2, 4, 3) + dots[..., None, None] * np.eye(3))
        blocks *= self.volume[:, None, None, None, None]
        dofs = (3 * body.tets[:, :, None] + np.arange(3)).reshape(m, 12)
        entries = blocks.transpose(0, 1, 3, 2, 4).reshape(m, 144)
        rows, columns = np.repeat(dofs, 12, axis=1).ravel(), np.tile(dofs, (1, 12)).ravel()
        # Fixed rows and columns are dropped before the sum, which costs the most.
        place = np.full(3 * n, -1, dtype=np.int32)
        place[body.free_dofs] = np.arange(len(body.free_dofs), dtype=np.int32)
        rows, columns, entries = place[rows], place[columns], entries.ravel()
        kept = (rows >= 0) & (columns >= 0)
        self.n = len(body.free_dofs)
        shape = (self.n, self.n)
        self.stiffness = sp.coo_matrix((entries[kept], (rows[kept], columns[kept])), shape).tocsr()
        lumped = np.bincount(
            body.tets.ravel(), np.repeat(body.density * self.volume / 4, 4), minlength=n
        )
        self.mass = np.repeat(lumped, 3)[body.free_dofs]

        # Row 9t + 3i + j of the gradient operator: ∂u_i/∂X_j of tet t.
        self._gradients, self._place, self._tets = gradients, place, body.tets
        self._operator = None

    @property
    def operator(self):
        """The sparse gradient operator (9m × n), by components: row (3i + j)·m + t."""
        if self._operator is None:
            m = len(self._tets)
            rows, columns, values = [], [], []
            for i in range(3):
                for j in range(3):
                    for a in range(4):
                        rows.append((3 * i + j) * m + np.arange(m))
                        columns.append(self._place[3 * self._tets[:, a] + i])
                        values.append(self._gradients[:, a, j])
            rows, columns, values = map(np.concatenate, (rows, columns, values))
            kept = columns >= 0
            entries = (values[kept], (rows[kept], columns[kept]))
            self._operator = sp.coo_matrix(entries, shape=(9 * m, self.n)).tocsr()
            self._adjoint = self._operator.T.tocsr()
        return self._operator

    @property
    def adjoint(self):
        self.operator  # noqa: B018 — makes both
        return self._adjoint

    def derivative_loads(self, shapes, pool):
        """−(H:φ_i)φ_j of every pair i ≤ j of the columns, St. Venant–Kirchhoff at rest. Pairs run on the
        threads of `pool`: NumPy and SciPy let go of the interpreter inside large arrays."""
        m, k = len(self.volume), shapes.shape[1]
        lam, mu = self.lame
        d = (self.operator @ shapes).reshape(3, 3, m, k)
        a = [np.ascontiguousarray(d[..., i]) for i in range(k)]
        s = [second_stress(0.5 * (g + g.transpose(1, 0, 2)), lam, mu) for g in a]
        pairs = [(i, j) for j in range(k) for i in range(j + 1)]

        def load(pair):
            i, j = pair
            p = product(a[i], s[j])
            p += product(a[j], s[i])
            mixed = product(a[i].transpose(1, 0, 2), a[j])
            p += second_stress(0.5 * (mixed + mixed.transpose(1, 0, 2)), lam, mu)
            p *= -self.volume
            return self.adjoint @ p.ravel()

        return np.stack(list(pool.map(load, pairs)), axis=1), pairs

    def stress(self, u):
        """First Piola–Kirchhoff stress at displacements u (n): (3, 3, m)."""
        lam, mu = self.lame
        a = (self.operator @ u).reshape(3, 3, -1)
        strain = 0.5 * (a + a.transpose(1, 0, 2) + product(a.transpose(1, 0, 2), a))
        s = second_stress(strain, lam, mu)
        return s + product(a, s)

    def internal_force(self, u):
        return self.adjoint @ (self.stress(u) * self.volume).ravel()


def product(a, b):
    """Products of 3 × 3 matrices by components: (3, 3, m)."""
    c = np.empty_like(b)
    for i in range(3):
        for j in range(3):
            np.multiply(a[i, 0], b[0, j], out=c[i, j])
            c[i, j] += a[i, 1] * b[1, j]
            c[i, j] += a[i, 2] * b[2, j]
    return c


def second_stress(strain, lam, mu):
    """2μE + λ tr(E) I, by components."""
    s = 2 * mu * strain
    trace = lam * (strain[0, 0] + strain[1, 1] + strain[2, 2])
    for i in range(3):
        s[i, i] += trace
    return s
