"""Noise that hides between steps: what is told, what is only bounded, and how surely."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration_rigs.plate_rig.correlation import correlation_area_px
from calibration_rigs.plate_rig.goodness import goodness_of_fit
from calibration_rigs.plate_rig.quantised import (
    PHASES,
    QuantisedSpread,
    count_readings,
    fit_spread,
    sheppard,
)
from calibration_rigs.plate_rig.step_law import expected_shares, shares_and_slopes

Float64Array = NDArray[np.float64]
_PIXELS = 1800


def _readings(
    before: float, behind: float, phases: str, seed: int = 0, frames: int = 10
) -> tuple[Float64Array, Float64Array]:
    """Return predicted places and readings, in steps; "one" phase is a plate facing the camera."""
    random = np.random.default_rng(seed)
    place = np.full(_PIXELS, 0.2) if phases == "one" else random.uniform(0.0, 7.0, _PIXELS)
    noise = random.standard_normal((2, frames, _PIXELS))
    return 100.0 + place, np.rint(100.0 + place + before * noise[0]) + behind * noise[1]


def _fit(before: float, behind: float, phases: str, seed: int = 0) -> QuantisedSpread:
    predicted, readings = _readings(before, behind, phases, seed)
    return fit_spread(count_readings(predicted, readings, np.arange(_PIXELS) // 60, 0.0))


@pytest.mark.parametrize("phases", ["one", "uniform"])
@pytest.mark.parametrize(("before", "behind"), [(0.32, 0.02), (0.45, 0.35), (0.9, 0.1)])
def test_noise_before_and_behind_the_steps_is_told(
    before: float, behind: float, phases: str
) -> None:
    found = _fit(before, behind, phases)
    assert not found.is_below
    assert found.sigma == pytest.approx(np.hypot(before, behind), rel=0.03)
    assert found.low < found.sigma < found.high < 1.1 * found.low
    assert abs(found.offset) < 0.05


@pytest.mark.parametrize("phases", ["one", "uniform"])
def test_noise_that_the_steps_hide_is_only_bounded(phases: str) -> None:
    found = _fit(0.1, 0.02, phases)
    assert found.is_below
    assert (found.low, found.sigma, found.high) == (0.0, 0.3, 0.3)
    # A plate of one phase says nothing about its place within the step.
    assert (found.offset_sigma > 0.2) == (phases == "one")


def test_intervals_cover_the_truth_in_95_of_100_draws() -> None:
    """150 draws with 95 % each give 135 to 149 but for once in 300; 98 % give 150 once in 20.

    `benchmarks/plate_rig.py` does a thousand whole cells.
    """
    truth = np.hypot(0.45, 0.1)
    found = [_fit(0.45, 0.1, "one", seed) for seed in range(150)]
    assert 135 <= sum(fit.low <= truth <= fit.high for fit in found) <= 149


def test_a_patch_that_knows_more_leaves_fewer_degrees_of_freedom() -> None:
    """Half of the readings in one of six patches: 1 / sum h^2 - 1 = 2.3 degrees, not 5."""
    predicted, readings = _readings(0.45, 0.02, "one")
    alike = fit_spread(count_readings(predicted, readings, np.arange(_PIXELS) // 300, 0.0))
    sizes = np.repeat(np.arange(6), [900, 180, 180, 180, 180, 180])
    uneven = [
        fit_spread(count_readings(*_readings(0.45, 0.02, "one", seed), sizes, 0.0))
        for seed in range(40)
    ]
    held = sum(fit.low <= np.hypot(0.45, 0.02) <= fit.high for fit in uneven)
    assert held >= 34
    assert np.median([fit.high / fit.low for fit in uneven]) > alike.high / alike.low


def test_pixels_that_share_their_noise_widen_the_interval() -> None:
    """Nine neighbours with one draw: N_eff falls about ninefold, the interval widens threefold."""
    random = np.random.default_rng(3)
    place = random.uniform(0.0, 7.0, _PIXELS)
    noise = np.repeat(random.standard_normal((10, _PIXELS // 9)), 9, axis=1)
    readings = np.rint(100.0 + place + 0.6 * noise)
    fit = fit_spread(count_readings(100.0 + place, readings, np.arange(_PIXELS) // 45, 0.0))
    assert 3.0 < fit.readings / fit.effective < 12.0
    assert fit.low <= 0.6 <= fit.high


def test_shares_are_probabilities_and_turn_with_the_phase() -> None:
    phases = (np.arange(PHASES) + 0.5) / PHASES
    shares = expected_shares(np.log([1.0, 0.4, 0.1]), phases, np.linspace(-6.0, 6.0, 97))
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, atol=1e-4)
    np.testing.assert_allclose(shares[0], shares[-1][::-1], atol=1e-9)  # phase p mirrors 1 - p


def test_slopes_of_the_shares_are_their_derivatives() -> None:
    phases, edges = np.array([0.1, 0.55, 0.8]), np.linspace(-3.0, 3.0, 49)
    at = np.array([0.2, np.log(0.4), np.log(0.15)])
    shares, slopes = shares_and_slopes(at, phases, edges)
    np.testing.assert_allclose(shares, expected_shares(at, phases, edges), rtol=1e-12)
    for axis, slope in zip(1e-5 * np.eye(3), slopes, strict=True):
        up, down = (expected_shares(at + sign * axis, phases, edges) for sign in (1.0, -1.0))
        np.testing.assert_allclose(slope, (up - down) / 2e-5, atol=1e-8)


def test_sheppard() -> None:
    assert sheppard(np.hypot(0.4, 1.0 / np.sqrt(12.0)), 1.0) == pytest.approx(0.4)
    assert sheppard(0.1, 1.0) == 0.0


def test_chi_square_takes_rounded_normals_and_refuses_others() -> None:
    predicted, readings = _readings(0.6, 0.05, "uniform", frames=1)
    spread = _fit(0.6, 0.05, "uniform", seed=1)
    kept = goodness_of_fit(spread, predicted, readings[0])
    assert kept is not None
    assert kept.p > 0.01
    two_humps = np.rint(predicted + np.where(np.arange(_PIXELS) % 2, 0.6, -0.6))
    refused = goodness_of_fit(spread, predicted, two_humps)
    assert refused is not None
    assert refused.p < 1e-6


def test_correlation_area() -> None:
    random = np.random.default_rng(0)
    white = random.standard_normal((4, 60, 60))
    assert correlation_area_px(white) == pytest.approx(1.0, abs=0.1)
    blocks = random.standard_normal((4, 20, 20)).repeat(3, axis=1).repeat(3, axis=2)
    # The mean over the places in a 3 x 3 block of sum rho is 9.
    assert correlation_area_px(blocks) == pytest.approx(9.0, rel=0.25)
    assert correlation_area_px(np.full((1, 5, 5), np.nan)) == 1.0
    assert correlation_area_px(np.full((2, 20, 20), 0.3, np.float32)) == 1.0
