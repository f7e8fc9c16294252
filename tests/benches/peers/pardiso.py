"""MKL Pardiso on a symmetric positive definite matrix, phase by phase.

The wrappers on PyPI hide the phases and the settings that a fair comparison needs; the interface is
one C function of libmkl_rt (oneMKL reference, "pardiso").
"""

import ctypes
import glob
import os
import sys

import numpy as np
import scipy.sparse as sp


def _library():
    folders = [os.path.join(sys.prefix, "lib"), os.path.join(sys.prefix, "Library", "bin")]
    for folder in folders:
        found = sorted(glob.glob(os.path.join(folder, "*mkl_rt*")))
        if found:
            return ctypes.CDLL(found[-1])
    raise OSError(f"no libmkl_rt in {folders}: pip install -r requirements.txt")


MKL = _library()


def set_threads(n):
    """Threads of every MKL call from now on."""
    MKL.MKL_Set_Num_Threads(ctypes.c_int(n))


class Pardiso:
    """A factorization A = LLᵀ; `upper` is the upper triangle of A in CSR, indices sorted."""

    def __init__(self, upper, ordering=2, two_level=0, solve=0):
        """`ordering` is iparm(2): 2 METIS, 3 its parallel version; `two_level` is iparm(24): 0 classic,
        1 two-level parallel factorization; `solve` is iparm(25): 0 parallel, 1 sequential, 2
        parallel whatever the factorization."""
        upper = sp.csr_matrix(upper)
        self.n = upper.shape[0]
        self._a = np.ascontiguousarray(upper.data, dtype=np.float64)
        self._ia = np.ascontiguousarray(upper.indptr, dtype=np.int32)
        self._ja = np.ascontiguousarray(upper.indices, dtype=np.int32)
        self._pt = np.zeros(64, dtype=np.int64)
        self._iparm = np.zeros(64, dtype=np.int32)
        self._iparm[0] = 1  # nothing by default
        self._iparm[1] = ordering
        self._iparm[7] = 0  # no refinement: pivots of an SPD matrix are never perturbed
        self._iparm[17] = -1  # count the factor's non-zeros
        self._iparm[18] = -1  # and operations
        self._iparm[23] = two_level
        self._iparm[24] = solve
        self._iparm[34] = 1  # indices from zero

    def _call(self, phase, b=None, x=None):
        k = 1 if b is None else b.shape[1]
        number = lambda v: ctypes.byref(ctypes.c_int32(v))
        address = lambda a: None if a is None else a.ctypes.data_as(ctypes.c_void_p)
        error = ctypes.c_int32(0)
        MKL.pardiso(
            address(self._pt), number(1), number(1), number(2), number(phase), number(self.n),
            address(self._a), address(self._ia), address(self._ja), None, number(k),
            address(self._iparm), number(0), address(b), address(x), ctypes.byref(error),
        )  # fmt: skip
        if error.value:
            raise RuntimeError(f"Pardiso phase {phase}: error {error.value}")

    def analyse(self):
        self._call(11)

    def factorize(self):
        self._call(22)

    def solve(self, b):
        """A⁻¹b of an n or n×k array (columns contiguous, or copied so)."""
        columns = np.asfortranarray(b.reshape(self.n, -1), dtype=np.float64)
        x = np.empty_like(columns)
        self._call(33, columns, x)
        return x.reshape(b.shape)

    @property
    def factor_nonzeros(self):
        return int(self._iparm[17])

    def free(self):
        self._call(-1)
