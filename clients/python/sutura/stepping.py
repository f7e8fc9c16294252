"""Implicit Newmark stepping of the reduced model on the client's side.

β = 1/4, γ = 1/2 (average acceleration) of q̈ + D q̇ + f(q) = f_ext, with UᵀMU = 1 and Rayleigh damping
D = α 1 + β K̃(0), each step solved by Newton's method.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .errors import MismatchError
from .evaluator import Evaluator

_BETA = 0.25
_GAMMA = 0.5
_MOST_NEWTON = 12
# Residual relative to the forces in play at which a step is solved.
_TOLERANCE = 1e-8


class Stepper:
    """Steps an evaluator in time, starting at rest at q = 0.

    Damping is the session's, from the evaluator's tables. Forces are reduced ones, Uᵀ f; gravity is added.
    """

    def __init__(
        self,
        evaluator: Evaluator,
        dt_s: float,
        gravity_m_s2: npt.ArrayLike = (0.0, -9.81, 0.0),
    ) -> None:
        """Prepare the damping, which belongs to the body at rest."""
        if not 0.0 < dt_s <= 1.0:
            raise ValueError(f"dt_s must be positive and at most 1 s, not {dt_s}")
        self.evaluator = evaluator
        self.dt_s = dt_s
        self.time_s = 0.0
        zero = np.zeros(evaluator.size)
        self.q, self.velocity, self.acceleration = zero, zero.copy(), zero.copy()
        # What the acceleration was found under: when the load jumps, acceleration jumps with it.
        self._load: npt.NDArray[np.floating] = zero.copy()
        rest = evaluator.evaluate(zero).stiffness
        alpha, beta = evaluator.damping.astype(np.float64)
        self._damping = alpha * np.eye(len(zero)) + beta * rest
        self._gravity = evaluator.gravity_loads @ np.asarray(gravity_m_s2, dtype=np.float64)

    def step(self, force: npt.ArrayLike | None = None) -> npt.NDArray[np.float64]:
        """Advance by ``dt_s`` under the reduced force (r,); returns q.

        Raises ArithmeticError, with nothing changed, if Newton's method does not converge: take
        shorter steps.
        """
        load = self._gravity
        if force is not None:
            given = np.asarray(force, dtype=np.float64)
            if given.shape != self.q.shape:
                detail = f"a force of the shape {given.shape} for {len(self.q)} coordinates"
                raise MismatchError(detail)
            load = load + given
        h = self.dt_s
        before = self.acceleration + (load - self._load)
        q = self.q + h * self.velocity + h * h * (0.5 - _BETA) * before
        v = self.velocity + h * (1.0 - _GAMMA) * before
        a = np.zeros_like(q)
        for _ in range(_MOST_NEWTON):
            x, w = q + _BETA * h * h * a, v + _GAMMA * h * a
            here = self.evaluator.evaluate(x)
            damped = self._damping @ w
            residual = a + damped + here.force - load
            parts = (a, damped, here.force, load)
            scale = max(float(np.linalg.norm(part)) for part in parts)
            if not np.isfinite(scale):
                break
            if float(np.linalg.norm(residual)) <= _TOLERANCE * scale:
                self.q, self.velocity, self.acceleration, self._load = x, w, a, load
                self.time_s += h
                return x
            matrix = np.eye(len(q)) + _GAMMA * h * self._damping + _BETA * h * h * here.stiffness
            a = a - np.linalg.solve(matrix, residual)
        raise ArithmeticError(f"the step at {self.time_s} s does not converge; take shorter steps")
