from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from simulation.devices.kinect import (
    CleanView,
    KinectModel,
    drop_out_probability,
    kinect_320,
    kinect_640,
    kinect_depth_mm,
    lit_by_projector,
)
from simulation.errors import SimulationError

# Lit from the camera itself: neighbours at random distances would cast shadows.
WIDE = KinectModel(baseline_m=0.0, range_min_m=0.3, range_max_m=9.0)


def wall(
    z_m: float, incidence_deg: float = 0.0, spread: float = 0.0, sun: float = 0.0
) -> CleanView:
    """A view of the same distance everywhere, or spread by a share to and fro."""
    z = np.full((480, 640), z_m)
    z *= 1.0 + spread * np.random.default_rng(8).uniform(-1.0, 1.0, z.shape)
    cosine = np.full_like(z, np.cos(np.radians(incidence_deg)))
    return CleanView(z, cosine, np.full_like(z, sun))


@pytest.mark.parametrize("z_m", [0.85, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 3.9])
@pytest.mark.parametrize("incidence_deg", [0.0, 30.0, 45.0])
def test_noise_is_within_a_tenth_of_nguyen(z_m: float, incidence_deg: float) -> None:
    view = wall(z_m, incidence_deg, spread=0.01)
    depth_mm = kinect_depth_mm(view, kinect_640(), WIDE, np.random.default_rng(1))
    error = depth_mm / 1000.0 - view.z_m
    theta = np.radians(incidence_deg)
    expected = 0.0012 + 0.0019 * (z_m - 0.4) ** 2
    expected += 0.0001 / np.sqrt(z_m) * theta**2 / (np.pi / 2.0 - theta) ** 2
    assert error.std() == pytest.approx(expected, rel=0.1)
    assert abs(error.mean()) < 0.02 * expected + 1e-5


def test_disparities_are_eighths_of_a_pixel() -> None:
    view = wall(2.0, spread=0.4)
    model = replace(WIDE, sigma_disparity_px=0.0, floor_sigma_m=0.0)
    depth_mm = kinect_depth_mm(view, kinect_640(), model, np.random.default_rng(1))
    steps = 43.5 / (depth_mm / 1000.0) * 8.0
    # Rounding to a millimetre moves a disparity of 43.5 / z by 21.75 / z^2 thousandths.
    assert np.abs(steps - np.rint(steps)).max() < 8.0 * 0.02175 / 1.2**2 + 1e-3
    assert len(np.unique(depth_mm)) == pytest.approx((43.5 / 1.2 - 43.5 / 2.8) * 8.0, abs=3)


def test_a_disparity_bias_moves_depth_with_its_square() -> None:
    for z_m in (1.0, 2.0, 3.5):
        biased = KinectModel(disparity_bias_px=0.2)
        depth_mm = kinect_depth_mm(wall(z_m), kinect_640(), biased, np.random.default_rng(2))
        found = depth_mm[depth_mm > 0].mean() / 1000.0 - z_m
        assert found == pytest.approx(43.5 / (43.5 / z_m + 0.2) - z_m, rel=0.05)


def test_a_near_thing_shadows_the_wall_to_its_left() -> None:
    z = np.full((240, 320), 2.0)
    z[:, 150:170] = 1.0
    ones = np.ones_like(z)
    lit = lit_by_projector(CleanView(z, ones, ones), kinect_320(), KinectModel())
    width = 290.0 * 0.075 * (1.0 / 1.0 - 1.0 / 2.0)
    dark = np.flatnonzero(~lit[100])
    assert dark.size == pytest.approx(width, abs=1.0)
    assert dark.max() == 149
    assert np.all(np.diff(dark) == 1)


def test_what_is_not_seen_is_not_lit_and_casts_no_shadow() -> None:
    z = np.full((240, 320), 2.0)
    z[:, 160:] = 0.0
    ones = np.ones_like(z)
    lit = lit_by_projector(CleanView(z, ones, ones), kinect_320(), KinectModel())
    assert lit[:, :160].all()
    assert not lit[:, 160:].any()


def test_grazing_views_drop_out() -> None:
    model = KinectModel()
    assert not drop_out_probability(wall(2.0, 80.0), model).any()
    assert drop_out_probability(wall(2.0, 85.5), model)[0, 0] == pytest.approx(0.5)
    assert drop_out_probability(wall(2.0, 89.5), model)[0, 0] == 1.0
    depth_mm = kinect_depth_mm(wall(2.0, 85.5), kinect_640(), model, np.random.default_rng(0))
    assert (depth_mm > 0).mean() == pytest.approx(0.5, abs=0.01)


def test_sunlight_drowns_the_pattern_far_away_first() -> None:
    model = KinectModel(sunlight=0.25)
    assert drop_out_probability(wall(2.0, sun=1.0), model)[0, 0] == pytest.approx(0.5)
    near, far = (drop_out_probability(wall(z, sun=1.0), model)[0, 0] for z in (1.0, 3.5))
    assert near < 0.1
    assert far > 0.85
    assert not drop_out_probability(wall(2.0, sun=0.0), model).any()
    assert not drop_out_probability(wall(2.0, sun=1.0), KinectModel()).any()


def test_readings_outside_the_range_are_dropped() -> None:
    for z_m in (0.7, 4.3):
        random = np.random.default_rng(0)
        assert not kinect_depth_mm(wall(z_m), kinect_640(), KinectModel(), random).any()


@pytest.mark.parametrize(
    "make",
    [
        lambda: KinectModel(disparity_px_m=0.0),
        lambda: KinectModel(disparity_step_px=0.0),
        lambda: KinectModel(sigma_disparity_px=-0.1),
        lambda: KinectModel(range_min_m=5.0),
        lambda: KinectModel(range_max_m=70.0),
        lambda: KinectModel(grazing_rad=(1.5, 1.4)),
        lambda: KinectModel(sunlight=-1.0),
        lambda: KinectModel(sunlight=float("nan")),
    ],
)
def test_impossible_sensors_are_refused(make: Callable[[], KinectModel]) -> None:
    with pytest.raises(SimulationError, match="expected positive"):
        make()
