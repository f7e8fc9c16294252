"""The bodies of paper_table through SciPy, ARPACK, MKL Pardiso and CHOLMOD, on this machine's threads.

    python peers.py --meshes DIR [--bodies a,b] [--repeat 5] [--out peers.json]

Every peer at its best: Pardiso's orderings, factorization and solve schemes and its threads are tried
on each body and the fastest is kept; CHOLMOD and the BLAS of NumPy and SciPy get the better of one
thread and all. Answers are checked here (backward error, residuals, force error) and against ours by paper_table.
"""

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time

import numpy as np
import scipy
import scipy.linalg
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, eigsh
from threadpoolctl import ThreadpoolController

import session
from fem import Body, Model
from pardiso import Pardiso, set_threads

PAPER = "stomach,plant,fork,dinosaur,oball"
N_MODES = 36
TOLERANCE = 1e-8
HERE = os.path.dirname(os.path.abspath(__file__))


def timed(repeat, work):
    """Seconds of each repetition, and the last result."""
    seconds = []
    for _ in range(repeat):
        start = time.perf_counter()
        result = work()
        seconds.append(time.perf_counter() - start)
    return seconds, result


def shifted(model, sigma):
    """The upper triangle of K + σM."""
    a = sp.triu(model.stiffness + sigma * sp.diags(model.mass), format="csr")
    a.sort_indices()
    return a


def backward_error(model, sigma, x, b):
    a = (model.stiffness + sigma * sp.diags(model.mass)).tocsr()
    norm = abs(a).sum(axis=1).max()
    return float(abs(a @ x - b).max() / (norm * abs(x).max() + abs(b).max()))


def lowest_modes(model, sigma, solver, k):
    """Eigenvalues λ, modes (M-orthonormal) by ARPACK on M^½ K_σ⁻¹ M^½."""
    root = np.sqrt(model.mass)
    n = model.n
    operator = LinearOperator((n, n), matvec=lambda y: root * solver.solve(root * y.ravel()))
    start = np.random.default_rng(0).standard_normal(n)
    theta, y = eigsh(operator, k=k, which="LM", tol=TOLERANCE, v0=start)
    order = np.argsort(-theta)
    return 1 / theta[order] - sigma, y[:, order] / root[:, None]


def elastic(values, modes):
    """Without the rigid modes. They are told by their eigenvalues, not counted: a single-vector method
    can miss copies of an eigenvalue that is zero twelve times."""
    kept = values > 1e-5 * values[-1]
    return values[kept], modes[:, kept]


def shift_of(model, n_rigid):
    """No shift for a body that is held; else its first elastic eigenvalue, from a low guess."""
    if n_rigid == 0:
        return 0.0
    sigma = 1e-6 * model.stiffness.diagonal().sum() / model.mass.sum()
    for _ in range(2):
        solver = Pardiso(shifted(model, sigma))
        solver.analyse()
        solver.factorize()
        values, _ = lowest_modes(model, sigma, solver, n_rigid + 1)
        solver.free()
        sigma = float(values[n_rigid])
    return sigma


def best_settings(upper, threads):
    """The fastest of Pardiso's parallel schemes for analysis, numbers and 32 columns together."""
    b = np.asfortranarray(np.random.default_rng(1).standard_normal((upper.shape[0], 32)))
    best = None
    for n_threads in sorted({1, threads}):
        set_threads(n_threads)
        for ordering in (2, 3):
            for two_level, solve in ((0, 0), (1, 0), (1, 2)):
                if n_threads == 1 and (ordering, two_level) != (2, 0):
                    continue
                solver = Pardiso(upper, ordering, two_level, solve)
                seconds = 0.0
                for work in (solver.analyse, solver.factorize, lambda: solver.solve(b)):
                    seconds += min(timed(2, work)[0])
                solver.free()
                found = seconds, n_threads, ordering, two_level, solve
                best = found if best is None else min(best, found)
    return best[1:]


def direct(model, sigma, repeat, threads):
    """Pardiso's times, and the solver ready for more."""
    upper = shifted(model, sigma)
    n_threads, *settings = best_settings(upper, threads)
    set_threads(n_threads)
    solver = Pardiso(upper, *settings)
    result = {"settings": f"{n_threads} threads, iparm(2, 24, 25) = {settings}"}
    result["analysis_s"], _ = timed(repeat, solver.analyse)
    result["numeric_s"], _ = timed(repeat, solver.factorize)
    b = np.asfortranarray(np.random.default_rng(1).standard_normal((model.n, 32)))
    one = np.ascontiguousarray(b[:, 0])
    result["solve_1_s"], _ = timed(repeat, lambda: solver.solve(one))
    result["solve_32_s"], x = timed(repeat, lambda: solver.solve(b))
    result["factor_nonzeros"] = solver.factor_nonzeros
    result["backward_error"] = backward_error(model, sigma, x, b)
    if result["backward_error"] > 1e-13:
        sys.exit(f"Pardiso's backward error is {result['backward_error']:.1e}")
    return result, solver, n_threads


def compile_cholmod(folder):
    """The path of cholmod.c compiled, or None and why not."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None, "no C compiler"
    program = os.path.join(folder, "cholmod")
    source = os.path.join(HERE, "cholmod.c")
    made = subprocess.run(
        [compiler, "-O2", source, "-lcholmod", "-lm", "-o", program], capture_output=True, text=True
    )
    if made.returncode:
        return None, "cholmod.h or its library is missing (libsuitesparse-dev)"
    return program, ""


def cholmod(program, upper, folder, repeat, threads):
    """CHOLMOD's times with the better number of threads."""
    prefix = os.path.join(folder, "matrix")
    upper.indptr.astype(np.int32).tofile(prefix + ".ptr")
    upper.indices.astype(np.int32).tofile(prefix + ".col")
    upper.data.tofile(prefix + ".val")
    best = None
    for n in sorted({1, threads}):
        environment = dict(os.environ, OPENBLAS_NUM_THREADS=str(n), OMP_NUM_THREADS=str(n))
        run = subprocess.run(
            [program, prefix, str(repeat)], env=environment, capture_output=True, text=True, check=True
        )
        result = json.loads(run.stdout)
        result["settings"] = f"{n} threads, METIS, supernodal, CHOLMOD {result.pop('version')}"
        cost = sum(float(np.median(result[key])) for key in ("analysis_s", "numeric_s", "solve_32_s"))
        best = min([b for b in (best, (cost, result)) if b], key=lambda pair: pair[0])
    return best[1]


def eigensolver(model, sigma, solver, n_rigid, repeat, threads):
    """The 36 lowest elastic modes; rigid ones come with them. Leaves the BLAS of SciPy with the number
    of threads that served best."""
    work = lambda: lowest_modes(model, sigma, solver, N_MODES + n_rigid)
    blas = ThreadpoolController().select(internal_api="openblas")
    trials = {}
    for n in sorted({1, threads}):
        blas.limit(limits=n)
        trials[n] = timed(1, work)[0][0]
    n_blas = min(trials, key=trials.get)
    blas.limit(limits=n_blas)
    seconds, (values, modes) = timed(repeat, work)
    values, modes = elastic(values, modes)
    values, modes = values[:N_MODES], modes[:, :N_MODES]
    weighted = model.mass[:, None] * modes
    theta = 1 / (values + sigma)
    defect = solver.solve(np.asfortranarray(weighted)) - modes * theta
    inverse = np.sqrt((model.mass[:, None] * defect**2).sum(axis=0)) / theta
    residual = np.linalg.norm(model.stiffness @ modes - weighted * values, axis=0)
    residual /= values * np.linalg.norm(weighted, axis=0)
    return {
        "n_modes": N_MODES,
        "blas_threads": n_blas,
        "seconds": seconds,
        "frequencies_hz": (np.sqrt(values) / (2 * np.pi)).tolist(),
        "inverse_residual": float(inverse.max()),
        "residual": float(residual.max()),
    }


def measure(body, arguments, program, threads, folder):
    assembly, model = timed(arguments.repeat, lambda: Model(body))
    n_rigid = body.n_rigid_modes()
    sigma = shift_of(model, n_rigid)
    pardiso, solver, n_threads = direct(model, sigma, arguments.repeat, threads)
    result = {"n_free_dofs": model.n, "assembly_s": assembly, "pardiso": pardiso, "cholmod": None}
    result["eigsh"] = eigensolver(
        model, sigma, solver, n_rigid, arguments.repeat, threads
    )
    settings = solver._iparm[[1, 23, 24]].tolist()
    solver.free()
    if program:
        upper = shifted(model, sigma)
        result["cholmod"] = cholmod(program, upper, folder, arguments.repeat, threads)
    result["session"] = None
    if body.name in arguments.sessions and n_rigid == 0:
        make = lambda upper: Pardiso(upper, *settings)
        result["session"] = session.measure(
            body, make, lowest_modes, shifted, arguments.repeat, threads
        )
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--meshes", required=True)
    parser.add_argument("--bodies", default=PAPER, type=lambda text: text.split(","))
    parser.add_argument("--sessions", default="stomach", type=lambda text: text.split(","))
    parser.add_argument("--repeat", default=5, type=int)
    parser.add_argument("--out", default="peers.json")
    arguments = parser.parse_args()
    threads = len(os.sched_getaffinity(0))
    results = {}
    with tempfile.TemporaryDirectory() as folder:
        program, reason = compile_cholmod(folder)
        for name in arguments.bodies:
            print(f"{name}: peers", file=sys.stderr, flush=True)
            body = Body(arguments.meshes, name)
            results[name] = measure(body, arguments, program, threads, folder)
    parts = [
        f"Python {platform.python_version()}, NumPy {np.__version__}, SciPy {scipy.__version__} (ARPACK, "
        f"relative residual {TOLERANCE:g})",
        "MKL Pardiso 2026.2",
        "CHOLMOD with METIS" if program else f"no CHOLMOD: {reason}",
    ]
    for name, result in results.items():
        parts.append(f"{name}: Pardiso {result['pardiso']['settings']}, "
                     f"SciPy's BLAS {result['eigsh']['blas_threads']} threads")
    with open(arguments.out, "w") as file:
        json.dump({"description": "; ".join(parts), "bodies": results}, file, indent=1)


if __name__ == "__main__":
    main()
