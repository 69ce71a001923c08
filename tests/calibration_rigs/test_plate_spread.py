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
    expected_shares,
    fit_spread,
    sheppard,
)

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


def test_intervals_cover_the_truth() -> None:
    """A dozen draws, the benchmark does a thousand; eight of twelve would be 1 in 500."""
    truth = np.hypot(0.45, 0.1)
    found = [_fit(0.45, 0.1, "uniform", seed) for seed in range(12)]
    assert sum(fit.low <= truth <= fit.high for fit in found) >= 9


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
