"""Cubature points by Kratos' empirical cubature, from the equations that ours are selected from.

    cargo bench --bench paper_table -- --training DIR
    python kratos.py DIR

Kratos' own recipe: an orthonormal basis of the elements' residuals, truncated at a tolerance (the SVD), then
`EmpiricalCubatureMethod` on it, which selects as many elements as the basis has columns. The tolerance is varied;
every rule is judged like ours, on the held-out poses. The weights are Kratos' and, in favour of it, fitted anew to all
training equations by non-negative least squares, as ours are.
"""

import contextlib
import io
import json
import pathlib
import sys

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import nnls

from KratosMultiphysics.RomApplication.empirical_cubature_method import EmpiricalCubatureMethod

RANKS = (20, 40, 60, 80, 120, 160, 240, 360, 480)
ERRORS = (0.05, 0.01)


def basis_of(rows):
    """Left singular vectors of the elements' equations (elements × equations), and singular values."""
    gram = (rows.T @ rows).astype(np.float64)
    values, vectors = eigh(gram)
    values, vectors = values[::-1], vectors[:, ::-1]
    keep = values > 1e-10 * values[0]
    sigma = np.sqrt(values[keep])
    return (rows @ vectors[:, keep].astype(np.float32)) / sigma.astype(np.float32), sigma


def select(basis):
    """Elements and weights."""
    method = EmpiricalCubatureMethod()
    method.SetUp(basis, constrain_sum_of_weights=True)
    with contextlib.redirect_stdout(io.StringIO()):
        method.Run()
    return np.atleast_1d(method.z), np.ravel(method.w)


def points_at(found, wanted):
    """Points at which the error falls to `wanted`, interpolated on logarithmic scales; as paper_table does."""
    before = None
    for n, e in found:
        if e <= wanted:
            if before is None:
                return float(n)
            share = np.log(before[1] / wanted) / np.log(before[1] / e)
            return float(np.exp(np.log(before[0]) + share * (np.log(n) - np.log(before[0]))))
        before = (n, e)
    return None


def measure(folder, name):
    rows = np.load(folder / f"{name}.training.npy")
    held_out = np.load(folder / f"{name}.held_out.npy")
    rows, target = rows[:-1], rows[-1].astype(np.float64)
    ours = json.loads((folder / f"{name}.ours.json").read_text())
    n_poses = ours["n_held_out"]

    def judge(elements, weights):
        residual = held_out[-1] - weights @ held_out[elements]
        return float(np.linalg.norm(residual) / np.sqrt(n_poses))

    found = {}
    for rule in ours["rules"]:
        found.setdefault(rule["method"], []).append((rule["n_points"], rule["error"]))
    basis, sigma = basis_of(rows)
    for rank in RANKS:
        if rank > basis.shape[1]:
            break
        elements, weights = select(basis[:, :rank].astype(np.float64))
        fitted, _ = nnls(rows[elements].T.astype(np.float64), target, maxiter=100 * rank)
        found.setdefault("Kratos", []).append((len(elements), judge(elements, weights)))
        found.setdefault("Kratos, weights fitted anew", []).append(
            (int((fitted > 0).sum()), judge(elements, fitted))
        )
    tail = np.sqrt(np.cumsum(sigma[::-1] ** 2))[::-1] / np.linalg.norm(sigma)
    return {
        "body": name,
        "rules": found,
        "points_at": {m: [points_at(f, e) for e in ERRORS] for m, f in found.items()},
        # What the best basis of so many functions over the elements leaves of them.
        "left_by_rank": {str(rank): float(tail[rank]) for rank in RANKS if rank < len(tail)},
    }


def main():
    folder = pathlib.Path(sys.argv[1])
    results = []
    for path in sorted(folder.glob("*.training.npy")):
        result = measure(folder, path.name.removesuffix(".training.npy"))
        results.append(result)
        print(f"\n{result['body']}\n| method | points at 5 % | at 1 % |\n|---|---|---|")
        for method, points in result["points_at"].items():
            print(f"| {method} | " + " | ".join("–" if p is None else f"{p:.0f}" for p in points) + " |")
        print("left by the best so many functions:", result["left_by_rank"])
    (folder / "kratos.json").write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
