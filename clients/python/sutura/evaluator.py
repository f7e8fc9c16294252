"""The reduced model on the client's side: energy, force and stiffness from the evaluator's tables.

Per cubature point, with weight w and rest volume V, the deformation gradient is F = 1 + Σ u_c ⊗ g_c
over the tet's corners c, whose displacements are u_c = B_c q. For St. Venant–Kirchhoff

    E = (FᵀF − 1)/2,  S = λ tr(E) 1 + 2μ E,  P = F S,  Ψ = μ E:E + λ/2 tr(E)²,

and stitches add qᵀSq/2. The gradients G = ∂F/∂q do not depend on q, so everything is a few matrix
products over all points at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import DecodeError, MismatchError
from .frames import FloatArray, Frame

_KNOWN = {
    "tets",
    "weights",
    "volumes_m3",
    "lame_pa",
    "shape_gradients",
    "basis_rows",
    "stitch_stiffness",
}


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Energy, force and tangent stiffness in reduced coordinates; with a leading axis for a batch."""

    energy_j: npt.NDArray[np.float64]
    """(…): strain energy in J, stitches included."""
    force: npt.NDArray[np.float64]
    """(…, r): +∂Ψ/∂q."""
    stiffness: npt.NDArray[np.float64]
    """(…, r, r)."""


@dataclass(frozen=True, eq=False)
class Evaluator:
    """The tables of a generation's reduced model: p points, r coordinates."""

    generation: int
    tets: npt.NDArray[np.uint32]
    """(p,): the tet of each point."""
    weights: FloatArray
    """(p,): cubature weights."""
    volumes_m3: FloatArray
    """(p,): rest volumes of the points' tets."""
    lame_pa: FloatArray
    """(p, 2): Lamé's λ and μ."""
    shape_gradients: FloatArray
    """(p, 4, 3): gradients of the four shape functions in 1/m."""
    basis_rows: FloatArray
    """(p, 4, 3, r): basis rows at the four corners."""
    stitch_stiffness: FloatArray
    """(r, r): reduced stiffness of the stitches."""

    @staticmethod
    def decode(frame: Frame) -> Evaluator:
        """Read the frame of an evaluator."""
        unknown = set(frame) - _KNOWN
        if unknown:
            raise DecodeError(f"the evaluator has tables unknown to this client: {sorted(unknown)}")
        tets = frame.take("tets", None)
        stitches = frame.take("stitch_stiffness", None, None)
        p, r = len(tets), len(stitches)
        return Evaluator(
            frame.generation,
            tets,
            frame.take("weights", p),
            frame.take("volumes_m3", p),
            frame.take("lame_pa", p, 2),
            frame.take("shape_gradients", p, 4, 3),
            frame.take("basis_rows", p, 4, 3, r),
            frame.take("stitch_stiffness", r, r),
        )

    @property
    def size(self) -> int:
        """The number of reduced coordinates r."""
        return len(self.stitch_stiffness)

    @cached_property
    def _gradients(self) -> npt.NDArray[np.float64]:
        """G = ∂F/∂q: (9 p, r)."""
        g = self.shape_gradients.astype(np.float64)
        rows = self.basis_rows.astype(np.float64)
        gradients: npt.NDArray[np.float64] = np.einsum("pcj,pcir->pijr", g, rows, optimize=True)
        return gradients.reshape(-1, self.size)

    @cached_property
    def _moduli(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """W V λ and w V μ of each point, with two axes to broadcast over matrices."""
        scale = self.weights.astype(np.float64) * self.volumes_m3
        lame = (self.lame_pa * scale[:, None])[:, :, None, None]
        return lame[:, 0], lame[:, 1]

    def _strain(self, q: npt.ArrayLike) -> tuple[Any, Any, Any, Any]:
        """Coordinates (…, r); F, E (…, p, 3, 3) and tr E (…, p, 1, 1) there."""
        x = np.asarray(q, dtype=np.float64)
        if x.ndim not in (1, 2) or x.shape[-1] != self.size:
            raise MismatchError(f"coordinates of the shape {x.shape} for a basis of {self.size}")
        f = (x @ self._gradients.T).reshape(*x.shape[:-1], -1, 3, 3) + np.eye(3)
        e = 0.5 * (np.swapaxes(f, -1, -2) @ f - np.eye(3))
        return x, f, e, np.trace(e, axis1=-2, axis2=-1)[..., None, None]

    def energy_j(self, q: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Strain energy in J at ``q``: (r,), or a batch (b, r)."""
        x, _, e, trace = self._strain(q)
        return self._energy_j(x, e, trace)

    def _energy_j(self, x: Any, e: Any, trace: Any) -> npt.NDArray[np.float64]:
        lame_lambda, mu = self._moduli
        density = (mu * e * e).sum((-1, -2)) + (0.5 * lame_lambda * trace**2)[..., 0, 0]
        stitched = 0.5 * ((x @ self.stitch_stiffness) * x).sum(-1)
        return np.asarray(density.sum(-1) + stitched)

    def force(self, q: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Reduced internal force +∂Ψ/∂q at ``q``: (r,), or a batch (b, r)."""
        x, f, e, trace = self._strain(q)
        return self._force(x, f, self._stress(e, trace))

    def _stress(self, e: Any, trace: Any) -> Any:
        """The second Piola–Kirchhoff stress S, times w V."""
        lame_lambda, mu = self._moduli
        return lame_lambda * trace * np.eye(3) + 2.0 * mu * e

    def _force(self, x: Any, f: Any, s: Any) -> npt.NDArray[np.float64]:
        stress = (f @ s).reshape(*x.shape[:-1], -1)
        return np.asarray(stress @ self._gradients + x @ self.stitch_stiffness)

    def evaluate(self, q: npt.ArrayLike) -> Evaluation:
        """Energy, force and tangent stiffness at ``q``: (r,), or a batch (b, r)."""
        x, f, e, trace = self._strain(q)
        s = self._stress(e, trace)
        flat = (-1, *f.shape[-3:])
        stiffness = np.stack(
            [self._stiffness(fb, sb) for fb, sb in zip(f.reshape(flat), s.reshape(flat), strict=True)]
        ).reshape(*x.shape[:-1], self.size, self.size)
        return Evaluation(self._energy_j(x, e, trace), self._force(x, f, s), stiffness)

    def _stiffness(self, f: Any, s: Any) -> npt.NDArray[np.float64]:
        """Gᵀ (∂P/∂F) G, with ∂P_ij/∂F_kl = δ_ik S_lj + λ F_ij F_kl + μ (F_il F_kj + (FFᵀ)_ik δ_jl)."""
        lame_lambda, mu = (m[..., None, None] for m in self._moduli)
        eye = np.eye(3)
        ik, jl = eye[:, None, :, None], eye[None, :, None, :]
        tangent = (
            ik * s[:, None, :, None, :]
            + lame_lambda * f[:, :, :, None, None] * f[:, None, None, :, :]
            + mu * np.einsum("pil,pkj->pijkl", f, f)
            + mu * np.einsum("pim,pkm->pik", f, f)[:, :, None, :, None] * jl
        ).reshape(-1, 9, 9)
        gradients = self._gradients.reshape(-1, 9, self.size)
        moved = (tangent @ gradients).reshape(-1, self.size)
        return np.asarray(self._gradients.T @ moved + self.stitch_stiffness)
