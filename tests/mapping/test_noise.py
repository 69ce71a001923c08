"""The noise model against numbers worked out by hand from its published formula."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mapping.errors import MappingError
from mapping.noise import (
    KINECT_QUANTISATION,
    KINECT_V1,
    NGUYEN_2012,
    PRESETS,
    DepthNoiseModel,
    constant_noise,
    independent_readings,
)


def _axial(model: DepthNoiseModel, z_m: float, angle_deg: float) -> float:
    return float(model.axial_sigma_m(np.array(z_m), np.array(math.radians(angle_deg))))


@pytest.mark.parametrize(
    ("z_m", "angle_deg", "sigma_m"),
    [
        (1.0, 0.0, 0.0012 + 0.0019 * 0.36),
        # theta / (90 deg - theta) is 1, 2 and 5 at 45, 60 and 75 degrees.
        (2.0, 45.0, 0.0012 + 0.004864 + 0.0000707107),
        (3.5, 60.0, 0.0012 + 0.018259 + 0.000213809),
        (0.4, 75.0, 0.0012 + 0.0 + 0.003952847),
    ],
)
def test_axial_sigma_of_nguyen_2012(z_m: float, angle_deg: float, sigma_m: float) -> None:
    assert _axial(NGUYEN_2012, z_m, angle_deg) == pytest.approx(sigma_m, rel=1e-6)


@pytest.mark.parametrize(
    ("z_m", "angle_deg", "sigma_m"),
    [(1.0, 0.0, 0.8 / 580.0), (3.0, 60.0, 0.87 * 3.0 / 580.0), (2.0, 75.0, 0.975 * 2.0 / 580.0)],
)
def test_lateral_sigma_of_nguyen_2012(z_m: float, angle_deg: float, sigma_m: float) -> None:
    angle = np.array(math.radians(angle_deg))
    found = float(NGUYEN_2012.lateral_sigma_m(np.array(z_m), angle, 580.0))
    assert found == pytest.approx(sigma_m, rel=1e-9)


def test_the_pole_at_90_degrees_is_never_reached() -> None:
    # At 84 degrees theta / (90 - theta) is 14.
    assert _axial(NGUYEN_2012, 1.0, 90.0) == pytest.approx(0.0012 + 0.000684 + 0.0001 * 14**2)
    assert _axial(NGUYEN_2012, 1.0, 84.5) == _axial(NGUYEN_2012, 1.0, 84.0)
    assert _axial(NGUYEN_2012, 1.0, 83.0) < _axial(NGUYEN_2012, 1.0, 84.0)


# z^2 / (8 f b) with f = 580 px and b = 75 mm, in millimetres.
@pytest.mark.parametrize(("z_m", "step_mm"), [(1.0, 2.874), (2.0, 11.494), (4.0, 45.977)])
def test_the_depth_step_counts_as_uniform_noise(z_m: float, step_mm: float) -> None:
    found_mm = 1000.0 * _axial(KINECT_QUANTISATION, z_m, 0.0)
    assert found_mm == pytest.approx(step_mm / math.sqrt(12.0), rel=1e-3)


def test_step_and_spread_add_as_variances() -> None:
    both = DepthNoiseModel("both", axial_offset_m=0.004, quantum_per_m=0.003 * math.sqrt(12.0))
    assert _axial(both, 1.0, 30.0) == pytest.approx(0.005)


def test_an_uncalibrated_kinect_may_be_off_by_a_twentieth_of_a_pixel_of_disparity() -> None:
    # 0.05 px * z^2 / (580 px * 75 mm) at 2 m.
    assert float(KINECT_V1.bias_sigma_at_m(np.array(2.0))) == pytest.approx(0.0045977, rel=1e-4)
    assert _axial(KINECT_V1, 2.0, 30.0) == _axial(NGUYEN_2012, 2.0, 30.0)


def test_a_constant_model_is_the_same_everywhere() -> None:
    model = constant_noise(0.007)
    assert _axial(model, 0.5, 0.0) == _axial(model, 3.9, 80.0) == 0.007
    assert float(model.lateral_sigma_m(np.array(2.0), np.array(0.5), 580.0)) == 0.0


@pytest.mark.parametrize("sigma_m", [0.0, -0.001, math.nan, math.inf, 66.0])
def test_a_constant_model_needs_a_positive_number(sigma_m: float) -> None:
    with pytest.raises(MappingError, match=r"constant depth noise is .* expected a number above 0"):
        constant_noise(sigma_m)


def test_a_range_is_the_only_thing_that_with_range_changes() -> None:
    model = KINECT_V1.with_range(0.5, 2.0)
    assert (model.range_min_m, model.range_max_m) == (0.5, 2.0)
    assert model.with_range(0.4, 4.0) == KINECT_V1


def test_presets_go_by_their_own_names() -> None:
    assert set(PRESETS) == {"nguyen2012", "kinect-v1", "kinect-quantisation"}
    assert all(model.name == name for name, model in PRESETS.items())


def _pairs(width: int, height: int, reach_px: float) -> float:
    """Return n^2 over the sum of exp(-(r / reach)^2) over all pairs of a width x height patch."""
    v, u = (axis.ravel() for axis in np.mgrid[:height, :width])
    apart2 = (u[:, np.newaxis] - u) ** 2 + (v[:, np.newaxis] - v) ** 2
    return float((width * height) ** 2 / np.exp(-apart2 / reach_px**2).sum())


def _area(reach_px: float) -> float:
    lags = np.arange(-40, 41)
    return float(np.exp(-((lags / reach_px) ** 2)).sum() ** 2)


@pytest.mark.parametrize("reach_px", [0.5, 0.8, 1.2, 1.8, 2.5, 3.66, 5.0])
def test_neighbours_that_share_noise_are_worth_what_their_pairs_say(reach_px: float) -> None:
    """Brute force over all pairs; n / A alone would be half of it at n = A = 42."""
    area = _area(reach_px)
    for side in (1, 2, 3, 4, 6, 9, 14, 25):
        told = float(independent_readings(np.array(float(side * side)), area))
        assert told == pytest.approx(_pairs(side, side, reach_px), rel=0.04)
    for width, height in ((5, 2), (9, 4), (12, 4), (16, 6)):
        told = float(independent_readings(np.array(float(width * height)), area))
        assert 0.88 < told / _pairs(width, height, reach_px) < 1.04


def test_one_reading_is_one_and_white_noise_is_not_shared() -> None:
    pixels = np.array([1.0, 2.0, 50.0, 1e4])
    np.testing.assert_allclose(independent_readings(pixels, 1.0), pixels)
    assert independent_readings(pixels, 42.0)[0] == 1.0
    assert np.all(independent_readings(pixels, 42.0) <= pixels)
