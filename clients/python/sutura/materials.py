"""Constitutive laws over many points at once: energy density, stress, and its derivative.

All take the displacement gradient D = F − 1, (…, p, 3, 3), and Lamé's constants λ and μ, (p,). Energies are
(…, p), first Piola–Kirchhoff stresses P = ∂Ψ/∂F (…, p, 3, 3), derivatives ∂P/∂F (p, 9, 9) for D (p, 3, 3),
over entries 3·row + column.

- linear: Ψ = λ/2 tr²ε + μ ε:ε with ε = sym D
- St. Venant–Kirchhoff: Ψ = λ/2 tr²E + μ E:E with E = (FᵀF − 1)/2
- stable neo-Hookean (Smith, De Goes and Kim 2018, eq. 14), with m = 4/3 μ, L = λ + 5/6 μ, s = tr FᵀF − 3,
  j = det F − 1: Ψ = ¾ m (s/2 − j) − m/2 (log(1 + s/4) − s/4) + L/2 j²
- Mooney–Rivlin: Ψ = c₁₀ (I − 3) + c₀₁ (II − 3) − d j + L/2 j² with d = 2c₁₀ + 4c₀₁, L = λ + 2c₁₀,
  c₁₀ + c₀₁ = μ/2
- corotational: Ψ = μ |F − R|² + λ/2 tr²(S − 1) with F = R S
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

Reals: TypeAlias = npt.NDArray[np.float64]

_ONE = np.eye(3)
# ε_ikm ε_jln: what makes the derivative of the cofactor of F.
_LEVI_CIVITA = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _LEVI_CIVITA[_i, _j, _k], _LEVI_CIVITA[_i, _k, _j] = 1.0, -1.0
# Sums of two stretches below this are taken for it: there the rotation is not differentiable.
_LEAST_STRETCH = 1e-6


class Law(Protocol):
    """A constitutive law with its constants at every point."""

    def energy_density(self, d: Reals) -> Reals:
        """Ψ in J/m³."""

    def stress(self, d: Reals) -> Reals:
        """P in Pa."""

    def stress_derivative(self, d: Reals) -> Reals:
        """∂P/∂F in Pa."""


def _column(values: Reals) -> Reals:
    return values[:, None, None]


def _transpose(a: Reals) -> Reals:
    return np.swapaxes(a, -1, -2)


def _dot(a: Reals, b: Reals) -> Reals:
    return np.asarray((a * b).sum((-1, -2)))


def _trace(a: Reals) -> Reals:
    return np.asarray(np.trace(a, axis1=-2, axis2=-1))


def _dyad(a: Reals, b: Reals) -> Reals:
    return a.reshape(-1, 9, 1) * b.reshape(-1, 1, 9)


def _cofactor(f: Reals) -> Reals:
    rows = [np.cross(f[..., i - 2, :], f[..., i - 1, :]) for i in range(3)]
    return np.stack(rows, axis=-2)


def _cross(f: Reals) -> Reals:
    """The matrix of ∂(cof F)/∂F: (p, 9, 9)."""
    return np.asarray(
        np.einsum("ikm,jln,pmn->pijkl", _LEVI_CIVITA, _LEVI_CIVITA, f, optimize=True).reshape(-1, 9, 9)
    )


def _det(d: Reals) -> Reals:
    return _dot(d[..., :1, :], np.cross(d[..., 1, :], d[..., 2, :])[..., None, :])


def _volume_change(d: Reals) -> Reals:
    """Det F − 1."""
    return np.asarray(_trace(d) + _trace(_cofactor(d)) + _det(d))


@dataclass(frozen=True)
class Linear:
    """Small-strain linear elasticity."""

    lam: Reals
    mu: Reals

    def energy_density(self, d: Reals) -> Reals:
        """Ψ in J/m³."""
        strain = 0.5 * (d + _transpose(d))
        return np.asarray(0.5 * self.lam * _trace(strain) ** 2 + self.mu * _dot(strain, strain))

    def stress(self, d: Reals) -> Reals:
        """P in Pa."""
        pressure = (self.lam * _trace(d))[..., None, None] * _ONE
        return np.asarray(pressure + _column(self.mu) * (d + _transpose(d)))

    def stress_derivative(self, d: Reals) -> Reals:
        """∂P/∂F in Pa."""
        swap = np.einsum("il,jk->ijkl", _ONE, _ONE).reshape(9, 9)
        return np.asarray(
            _column(self.mu) * (np.eye(9) + swap) + _column(self.lam) * np.outer(_ONE.ravel(), _ONE.ravel())
        )


@dataclass(frozen=True)
class StVenantKirchhoff:
    """St. Venant–Kirchhoff."""

    lam: Reals
    mu: Reals

    def _second_stress(self, d: Reals) -> tuple[Reals, Reals]:
        e = 0.5 * (d + _transpose(d) + _transpose(d) @ d)
        s = (self.lam * _trace(e))[..., None, None] * _ONE + 2.0 * _column(self.mu) * e
        return e, s

    def energy_density(self, d: Reals) -> Reals:
        """Ψ in J/m³."""
        e, _ = self._second_stress(d)
        return np.asarray(0.5 * self.lam * _trace(e) ** 2 + self.mu * _dot(e, e))

    def stress(self, d: Reals) -> Reals:
        """P = F S."""
        _, s = self._second_stress(d)
        return np.asarray(s + d @ s)

    def stress_derivative(self, d: Reals) -> Reals:
        """∂P_ij/∂F_kl = δ_ik S_lj + λ F_ij F_kl + μ (F_il F_kj + (FFᵀ)_ik δ_jl)."""
        _, s = self._second_stress(d)
        f = d + _ONE
        geometric = np.einsum("ik,plj->pijkl", _ONE, s).reshape(-1, 9, 9)
        mixed = np.einsum("pil,pkj->pijkl", f, f)
        mixed += np.einsum("pik,jl->pijkl", f @ _transpose(f), _ONE)
        shear = _column(self.mu) * mixed.reshape(-1, 9, 9)
        return np.asarray(geometric + _column(self.lam) * _dyad(f, f) + shear)


@dataclass(frozen=True)
class NeoHookean:
    """Stable neo-Hookean, with Lamé's constants of small strains."""

    lam: Reals
    mu: Reals

    def _constants(self) -> tuple[Reals, Reals]:
        return self.lam + 5.0 / 6.0 * self.mu, 4.0 / 3.0 * self.mu

    def energy_density(self, d: Reals) -> Reals:
        """Ψ in J/m³."""
        lam, mu = self._constants()
        squares = _dot(d, d)
        quarter = 0.25 * (2.0 * _trace(d) + squares)
        shape = 0.5 * squares - _trace(_cofactor(d)) - _det(d)
        log_remainder = np.log1p(quarter) - quarter
        return np.asarray(mu * (0.75 * shape - 0.5 * log_remainder) + 0.5 * lam * _volume_change(d) ** 2)

    def stress(self, d: Reals) -> Reals:
        """P = ¾m (F − cof F) + m (¼ − 1/(4 + s)) F + L j cof F."""
        lam, mu = self._constants()
        f = d + _ONE
        cofactor = _cofactor(f)
        s = 2.0 * _trace(d) + _dot(d, d)
        stretch = (mu * s / (4.0 * (4.0 + s)))[..., None, None]
        pressure = (lam * _volume_change(d))[..., None, None]
        return np.asarray(0.75 * _column(mu) * (f - cofactor) + stretch * f + pressure * cofactor)

    def stress_derivative(self, d: Reals) -> Reals:
        """∂P/∂F in Pa."""
        lam, mu = self._constants()
        f = d + _ONE
        cofactor = _cofactor(f)
        s = 2.0 * _trace(d) + _dot(d, d)
        return np.asarray(
            _column(mu * (0.75 + s / (4.0 * (4.0 + s)))) * np.eye(9)
            + _column(2.0 * mu / (4.0 + s) ** 2) * _dyad(f, f)
            + _column(lam) * _dyad(cofactor, cofactor)
            + _column(lam * _volume_change(d) - 0.75 * mu) * _cross(f)
        )


@dataclass(frozen=True)
class MooneyRivlin:
    """Compressible Mooney–Rivlin; ``ratio`` is c₀₁/(c₁₀ + c₀₁)."""

    lam: Reals
    mu: Reals
    ratio: Reals

    def _constants(self) -> tuple[Reals, Reals, Reals, Reals]:
        c01 = 0.5 * self.mu * self.ratio
        c10 = 0.5 * self.mu - c01
        return c10, c01, self.lam + 2.0 * c10, 2.0 * c10 + 4.0 * c01

    def energy_density(self, d: Reals) -> Reals:
        """Ψ in J/m³."""
        c10, c01, bulk, tension = self._constants()
        change = _cofactor(d + _ONE) - _ONE
        second = _trace(_cofactor(d))
        return np.asarray(
            c10 * _dot(d, d)
            + c01 * (2.0 * second + _dot(change, change))
            - tension * (second + _det(d))
            + 0.5 * bulk * _volume_change(d) ** 2
        )

    def stress(self, d: Reals) -> Reals:
        """P = 2c₁₀ F + 2c₀₁ F ⨯ cof F + (L j − d) cof F."""
        c10, c01, bulk, tension = self._constants()
        f = d + _ONE
        cofactor = _cofactor(f)
        product = np.einsum(
            "ikm,jln,...kl,...mn->...ij", _LEVI_CIVITA, _LEVI_CIVITA, f, cofactor, optimize=True
        )
        pressure = (bulk * _volume_change(d) - tension)[..., None, None]
        return np.asarray(2.0 * _column(c10) * f + 2.0 * _column(c01) * product + pressure * cofactor)

    def stress_derivative(self, d: Reals) -> Reals:
        """∂P/∂F in Pa."""
        c10, c01, bulk, tension = self._constants()
        f = d + _ONE
        cofactor = _cofactor(f)
        along = _cross(f)
        return np.asarray(
            2.0 * _column(c10) * np.eye(9)
            + 2.0 * _column(c01) * (_cross(cofactor) + along @ along)
            + _column(bulk) * _dyad(cofactor, cofactor)
            + _column(bulk * _volume_change(d) - tension) * along
        )


@dataclass(frozen=True)
class Corotational:
    """Corotational linear elasticity."""

    lam: Reals
    mu: Reals

    @staticmethod
    def _polar(d: Reals) -> tuple[Reals, Reals, Reals]:
        """Rotations U and V and stretches with F = U Σ Vᵀ; the least takes the sign of det F."""
        u, stretches, vt = np.linalg.svd(d + _ONE)
        sign = np.sign(np.linalg.det(u @ vt))
        # Both U and V are made rotations; the least stretch keeps the product.
        flip_u, flip_v = np.sign(np.linalg.det(u)), np.sign(np.linalg.det(vt))
        u[..., :, 2] *= flip_u[..., None]
        vt[..., 2, :] *= flip_v[..., None]
        stretches[..., 2] *= sign
        return u, stretches, vt

    def energy_density(self, d: Reals) -> Reals:
        """Ψ in J/m³."""
        _, stretches, _ = self._polar(d)
        strains = stretches - 1.0
        return np.asarray(self.mu * (strains**2).sum(-1) + 0.5 * self.lam * strains.sum(-1) ** 2)

    def stress(self, d: Reals) -> Reals:
        """P = 2μ (F − R) + λ tr(S − 1) R."""
        u, stretches, vt = self._polar(d)
        rotation = u @ vt
        pressure = (self.lam * (stretches - 1.0).sum(-1))[..., None, None]
        return np.asarray(2.0 * _column(self.mu) * (d + _ONE - rotation) + pressure * rotation)

    def stress_derivative(self, d: Reals) -> Reals:
        """2μ + λ R⊗R + (λ tr(S − 1) − 2μ) ∂R/∂F, with ∂R/∂F = Σ 2/(σ_i + σ_j) T_ij⊗T_ij over the twists."""
        u, stretches, vt = self._polar(d)
        rotation = u @ vt
        turning = np.zeros((len(d), 9, 9))
        for i, j in ((0, 1), (1, 2), (0, 2)):
            twist = u[..., :, i, None] * vt[..., None, j, :] - u[..., :, j, None] * vt[..., None, i, :]
            both = stretches[..., i] + stretches[..., j]
            both = np.where(np.abs(both) < _LEAST_STRETCH, _LEAST_STRETCH, both)
            turning += _column(1.0 / both) * _dyad(twist, twist)
        factor = self.lam * (stretches - 1.0).sum(-1) - 2.0 * self.mu
        return np.asarray(
            2.0 * _column(self.mu) * np.eye(9)
            + _column(self.lam) * _dyad(rotation, rotation)
            + _column(factor) * turning
        )


LAWS: tuple[Callable[[Reals, Reals, Reals], Any], ...] = (
    lambda lam, mu, _: Linear(lam, mu),
    lambda lam, mu, _: StVenantKirchhoff(lam, mu),
    lambda lam, mu, _: NeoHookean(lam, mu),
    MooneyRivlin,
    lambda lam, mu, _: Corotational(lam, mu),
)
"""By the number that the evaluator's tables give a law: of λ, μ and Mooney's ratio."""

STVK = 1
