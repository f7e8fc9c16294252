"""The reduced model on the client's side: energy, force and stiffness from the evaluator's tables.

Per cubature point, with weight w and rest volume V, the displacement gradient is D = F − 1 = Σ u_c ⊗ g_c over
the tet's corners c, whose displacements are u_c = B_c q: D = G q, and G does not depend on q. With the energy
density Ψ of the point's material law (``sutura.materials``) and P = ∂Ψ/∂F

    energy = Σ w V Ψ + qᵀSq/2,  force = Σ w V Gᵀ P + S q,  stiffness = Σ w V Gᵀ (∂P/∂F) G + S,

S being the stiffness of the stitches: a few matrix products over all points at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import DecodeError, MismatchError
from .frames import FloatArray, Frame
from .materials import LAWS, Law

_KNOWN = {
    "tets",
    "weights",
    "volumes_m3",
    "lame_pa",
    "shape_gradients",
    "basis_rows",
    "stitch_stiffness",
    "laws",
    "mooney_ratios",
    "gravity_loads",
    "damping",
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
    """(p, 4, 3, r): basis rows at the four corners, or of a displacement with the point's gradient."""
    stitch_stiffness: FloatArray
    """(r, r): reduced stiffness of the stitches."""
    laws: npt.NDArray[np.uint32]
    """(p,): number of each point's material law, a place in ``sutura.materials.LAWS``."""
    mooney_ratios: FloatArray
    """(p,): C₀₁/(C₁₀ + C₀₁), of effect for Mooney–Rivlin alone."""
    gravity_loads: FloatArray
    """(r, 3): reduced load of unit gravity along each axis, in kg."""
    damping: FloatArray
    """(2,): Rayleigh damping, α in 1/s and β in s."""

    @staticmethod
    def decode(frame: Frame) -> Evaluator:
        """Read the frame of an evaluator."""
        unknown = set(frame) - _KNOWN
        if unknown:
            raise DecodeError(f"the evaluator has tables unknown to this client: {sorted(unknown)}")
        tets = frame.take("tets", None)
        stitches = frame.take("stitch_stiffness", None, None)
        p, r = len(tets), len(stitches)
        laws = frame.take("laws", p)
        if p and laws.max() >= len(LAWS):
            raise DecodeError(f"the evaluator has material law {laws.max()}, unknown to this client")
        return Evaluator(
            frame.generation,
            tets,
            frame.take("weights", p),
            frame.take("volumes_m3", p),
            frame.take("lame_pa", p, 2),
            frame.take("shape_gradients", p, 4, 3),
            frame.take("basis_rows", p, 4, 3, r),
            stitches,
            laws,
            frame.take("mooney_ratios", p),
            frame.take("gravity_loads", r, 3),
            frame.take("damping", 2),
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
    def _materials(self) -> list[tuple[npt.NDArray[np.intp], Law]]:
        """Each law with the points that follow it."""
        found = []
        lame = self.lame_pa.astype(np.float64)
        for number in np.unique(self.laws):
            at = np.flatnonzero(self.laws == number)
            law = LAWS[number](lame[at, 0], lame[at, 1], self.mooney_ratios[at].astype(np.float64))
            found.append((at, law))
        return found

    @cached_property
    def _scale(self) -> npt.NDArray[np.float64]:
        """W V of each point."""
        return np.asarray(self.weights.astype(np.float64) * self.volumes_m3)

    def _displacement_gradient(self, q: npt.ArrayLike) -> tuple[Any, Any]:
        """Coordinates (…, r), and D there, (…, p, 3, 3)."""
        x = np.asarray(q, dtype=np.float64)
        if x.ndim not in (1, 2) or x.shape[-1] != self.size:
            raise MismatchError(f"coordinates of the shape {x.shape} for a basis of {self.size}")
        return x, (x @ self._gradients.T).reshape(*x.shape[:-1], -1, 3, 3)

    def energy_j(self, q: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Strain energy in J at ``q``: (r,), or a batch (b, r)."""
        return self._energy_j(*self._displacement_gradient(q))

    def _energy_j(self, x: Any, d: Any) -> npt.NDArray[np.float64]:
        density = np.empty(d.shape[:-2])
        for at, law in self._materials:
            density[..., at] = law.energy_density(d[..., at, :, :])
        stitched = 0.5 * ((x @ self.stitch_stiffness) * x).sum(-1)
        return np.asarray(density @ self._scale + stitched)

    def force(self, q: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Reduced internal force +∂Ψ/∂q at ``q``: (r,), or a batch (b, r)."""
        return self._force(*self._displacement_gradient(q))

    def _force(self, x: Any, d: Any) -> npt.NDArray[np.float64]:
        stress = np.empty_like(d)
        for at, law in self._materials:
            stress[..., at, :, :] = law.stress(d[..., at, :, :])
        stress *= self._scale[:, None, None]
        flat = stress.reshape(*x.shape[:-1], -1)
        return np.asarray(flat @ self._gradients + x @ self.stitch_stiffness)

    def evaluate(self, q: npt.ArrayLike) -> Evaluation:
        """Energy, force and tangent stiffness at ``q``: (r,), or a batch (b, r)."""
        x, d = self._displacement_gradient(q)
        stiffness = np.stack([self._stiffness(one) for one in d.reshape(-1, *d.shape[-3:])])
        shape = (*x.shape[:-1], self.size, self.size)
        return Evaluation(self._energy_j(x, d), self._force(x, d), stiffness.reshape(shape))

    def _stiffness(self, d: Any) -> npt.NDArray[np.float64]:
        gradients = self._gradients.reshape(-1, 9, self.size)
        tangent = np.empty((len(d), 9, 9))
        for at, law in self._materials:
            tangent[at] = law.stress_derivative(d[at])
        tangent *= self._scale[:, None, None]
        moved = (tangent @ gradients).reshape(-1, self.size)
        return np.asarray(self._gradients.T @ moved + self.stitch_stiffness)
