"""One cell of the plate rig: what comes out, and what is wrong with it, in plain words."""

from __future__ import annotations

from dataclasses import replace
from math import degrees, radians

import numpy as np
import pytest

from calibration_rigs.errors import RigError
from calibration_rigs.plate_rig.cell import analyse
from calibration_rigs.plate_rig.cell_result import CellResult
from calibration_rigs.plate_rig.frames import CellFrames
from calibration_rigs.plate_rig.manifest import CellEntry, Rig
from drivers.samples import CameraIntrinsics
from mapping.calibration_file import DeviceIdentity
from simulation.devices.kinect import KinectModel
from tests.fakes.plate_rig import Plate, frames_of, true_bias_m, true_sigma_m

# A Kinect decimated by 4; the disparity's steps are those of the 640 px wide image.
CAMERA = CameraIntrinsics(160, 120, 145.0, 145.0, 79.5, 59.5)
MODEL = KinectModel(disparity_bias_px=0.05)


def result_of(
    plate: Plate,
    frames: int = 12,
    corners: tuple[float, float, float] | None = None,
    model: KinectModel = MODEL,
    **told: float,
) -> CellResult:
    """Return the result for a plate that stands, or is told to stand, somewhere."""
    depth_mm = frames_of(plate, frames, 0, model, CAMERA)
    cell = CellEntry(
        recording="x",
        distance_m=told.get("distance_m", plate.z_m),
        angle_deg=told.get("angle_deg", plate.angle_deg),
        corners_m=corners,
    )
    return analyse(CellFrames(depth_mm, CAMERA, DeviceIdentity(), ""), cell, Rig()).result


def fault_of(result: CellResult, kind: str) -> str:
    """Return the text of a fault; fails when there is none of the kind."""
    texts = [fault.text for fault in result.faults if fault.kind == kind]
    assert texts, [fault.kind for fault in result.faults]
    return texts[0]


@pytest.mark.parametrize(("z_m", "angle"), [(1.4, 0.0), (1.8, 60.0), (2.6, 30.0)])
def test_sigma_bias_and_attitude(z_m: float, angle: float) -> None:
    plate = Plate(z_m, angle)
    result = result_of(plate, corners=plate.corners_m(np.random.default_rng(0)))
    truth = true_sigma_m(MODEL, result.z_m, result.incidence_rad)
    assert result.sigma_m == pytest.approx(truth, rel=0.05)
    assert result.error_m is not None
    expected = true_bias_m(MODEL, z_m)
    assert abs(result.error_m - expected) < max(4.0 * result.error_sigma_m, 0.002)
    assert degrees(result.turn_rad) == pytest.approx(angle, abs=0.5)
    assert abs(degrees(result.tip_rad)) < 0.3
    assert result.is_used
    assert [fault.kind for fault in result.faults if fault.kind not in ("frames", "pixels")] == []


def test_what_is_said_beside_sigma() -> None:
    result = result_of(Plate(1.6, 0.0))
    assert result.fill_rate == pytest.approx(1.0, abs=0.01)
    assert result.temporal.still_share < 0.05
    assert result.correlation_area_px / 16.0 == pytest.approx(1.0, abs=0.2)
    assert result.subpixel_rms_px == pytest.approx(np.hypot(0.056, 0.125 / np.sqrt(12)), rel=0.2)
    # The paper's estimate is that of means over the rows, and smaller by their root.
    ratio = result.plain_sigma_m / result.paper.column_sigma_m
    assert ratio == pytest.approx(np.sqrt(result.paper.rows), rel=0.2)
    assert result.paper.grid_mean_m == pytest.approx(1.6, abs=0.01)


def test_a_quiet_sensor_is_below_and_stands_still() -> None:
    quiet = KinectModel(sigma_disparity_px=0.01, floor_sigma_m=1e-5)
    result = result_of(Plate(2.4, 0.0), model=quiet)
    assert result.spread.is_below
    assert result.temporal.still_share > 0.8
    assert result.error_sigma_m > 0.003  # the step hides where the plate is


def test_edges_that_tremble() -> None:
    random = np.random.default_rng(0)
    depth_mm = frames_of(Plate(1.6, 0.0), 12, 0, MODEL, CAMERA)
    for frame in depth_mm:
        for row in frame:
            left = np.flatnonzero(row)[:1]
            if left.size:
                row[: left[0] + round(2.0 + random.normal(0.0, 1.0))] = 0
    cell = CellEntry(recording="x", distance_m=1.6, angle_deg=0.0)
    result = analyse(CellFrames(depth_mm, CAMERA, DeviceIdentity(), ""), cell, Rig()).result
    # One edge of two trembles by 1 px of an image that is decimated by 4.
    assert result.lateral_px == pytest.approx(4.0 / np.sqrt(2.0), rel=0.25)


def test_a_bent_plate() -> None:
    result = result_of(Plate(1.6, 0.0, bend_m=0.02))
    # The rim that is eroded takes its share of the 20 mm with it.
    assert "the plate is bent: 16 mm between its middle and its rim" in fault_of(result, "bent")
    assert not result.is_used


def test_a_plate_that_is_too_small() -> None:
    result = result_of(Plate(1.6, 0.0, width_m=0.6, height_m=0.6))
    text = fault_of(result, "size")
    assert "0.59 m wide and 0.59 m high, expected 1.00 m x 1.00 m" in text  # to a pixel of 1 cm
    assert not result.is_used


def test_a_tilted_plate_and_a_tripod_that_lies() -> None:
    result = result_of(Plate(1.6, 20.0, tip_deg=3.0), angle_deg=15.0)
    assert "it leans by 3." in fault_of(result, "tilted")
    assert "turned by 20.0 deg, the tripod says 15.0 deg" in fault_of(result, "angle")
    assert result.is_used


@pytest.mark.parametrize("plate", [Plate(3.6, 0.0), Plate(1.6, x_m=5.0)])
def test_a_missing_plate(plate: Plate) -> None:
    with pytest.raises(RigError, match=r"no plate: \d+ pixels read between 1\.\d\d and 1\.\d\d m"):
        result_of(plate, distance_m=1.6)


def test_a_wall_is_no_plate() -> None:
    result = result_of(Plate(1.6, 0.0, wall_m=2.5))
    assert result.z_m == pytest.approx(1.6, abs=0.02)
    assert result.is_used


def test_half_out_of_view() -> None:
    result = result_of(Plate(1.6, 0.0, x_m=0.75))
    assert "cut off at the right border" in fault_of(result, "view")
    assert not result.is_used


@pytest.mark.parametrize("corner", [0, 1, 2])
def test_a_tape_typo_of_20_cm(corner: int) -> None:
    plate = Plate(1.8, 30.0)
    corners = list(plate.corners_m(np.random.default_rng(0)))
    corners[corner] += 0.2
    result = result_of(plate, corners=(corners[0], corners[1], corners[2]))
    names = ("top left", "top right", "bottom left")
    text = fault_of(result, "tape")
    assert text.startswith(f"the tape to the {names[corner]} corner says {corners[corner]:.3f} m")
    assert result.error_m is None
    assert not result.is_used


def test_too_few_frames() -> None:
    assert result_of(Plate(1.6, 0.0), frames=12).is_used
    few = result_of(Plate(1.6, 0.0), frames=5)
    assert fault_of(few, "frames").startswith("5 frames, expected at least 100")
    assert not few.is_used


def test_a_plate_that_reaches_out_of_range_is_seen_in_part() -> None:
    """At 1 m and 60 deg the near side is closer than a Kinect can see."""
    plate = Plate(1.1, 60.0)
    result = result_of(plate, corners=plate.corners_m(np.random.default_rng(1)))
    assert result.is_used
    assert result.error_m is not None
    assert abs(result.error_m) < 0.03


def test_the_incidence_is_that_of_the_rays() -> None:
    plate = Plate(1.6, 30.0)
    result = result_of(replace(plate, x_m=-0.2))
    seen_at = radians(30.0) - np.arctan2(-0.2, 1.6)
    assert abs(degrees(result.incidence_rad - abs(seen_at))) < 2.0
