"""Constitutive laws against each other and against differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sutura.materials import LAWS

N = 40
LAM, MU, RATIO = np.full(N, 3e5), np.full(N, 2e5), np.full(N, 0.3)


@pytest.mark.parametrize("make", LAWS)
def test_stress_and_its_derivative_are_gradients(make: Any) -> None:
    law = make(LAM, MU, RATIO)
    d = 0.3 * np.random.default_rng(1).standard_normal((N, 3, 3))
    # One that is inside out.
    d[0] = np.diag([0.1, 0.0, -1.4])
    step = 1e-5
    stress = law.stress(d)
    derivative = law.stress_derivative(d)
    np.testing.assert_allclose(derivative, np.swapaxes(derivative, 1, 2), atol=1e-6 * 1e6)
    for entry in range(9):
        moved = np.zeros((3, 3))
        moved.flat[entry] = step
        slope = (law.energy_density(d + moved) - law.energy_density(d - moved)) / (2 * step)
        np.testing.assert_allclose(slope, stress.reshape(N, 9)[:, entry], atol=1e-4 * 1e6)
        slope = (law.stress(d + moved) - law.stress(d - moved)) / (2 * step)
        np.testing.assert_allclose(slope.reshape(N, 9), derivative[:, :, entry], atol=1e-4 * 1e7)


@pytest.mark.parametrize("make", LAWS)
def test_all_laws_agree_at_rest(make: Any) -> None:
    law, linear = make(LAM, MU, RATIO), LAWS[0](LAM, MU, RATIO)
    rest = np.zeros((N, 3, 3))
    assert np.abs(law.energy_density(rest)).max() == 0
    assert np.abs(law.stress(rest)).max() < 1e-9 * 1e5
    np.testing.assert_allclose(law.stress_derivative(rest), linear.stress_derivative(rest), atol=1e-9 * 1e5)
