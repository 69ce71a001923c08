"""A sensor whose pixels are off by known disparities, and the map that takes them off."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import cli
from calibration_rigs.plate_rig.cell import analyse
from calibration_rigs.plate_rig.frames import CellFrames
from calibration_rigs.plate_rig.manifest import CellEntry, Rig
from drivers.samples import CameraIntrinsics, DepthFrame
from mapping.calibration_file import DeviceIdentity
from mapping.errors import MappingError
from mapping.mapper import Mapper
from mapping.noise import NGUYEN_2012
from mapping.settings import MapSettings
from mapping.undistortion import Undistortion, read_undistortion
from simulation.devices.kinect import KinectModel
from tests.fakes.plate_rig import Plate, frames_of
from tests.mapping.scenes import looking, mount, plane_z, pose_sample

CAMERA = CameraIntrinsics(160, 120, 145.0, 145.0, 79.5, 59.5)
FOCAL_BASELINE = 43.5


def _distortion_px() -> NDArray[np.float64]:
    """Return a bowl: 0 in the middle, 0.35 px of the 640 px wide image in the corners."""
    v, u = np.mgrid[:120, :160]
    bowl = (u - 79.5) ** 2 + (v - 59.5) ** 2
    return np.asarray(0.35 * bowl / bowl[0, 0], np.float64)


def _distorted_mm(z_m: NDArray[np.float64]) -> NDArray[np.uint16]:
    """Return what the sensor reads where z_m is true; 0 stays."""
    disparity = FOCAL_BASELINE / np.where(z_m > 0.0, z_m, 1.0) + _distortion_px()
    return np.where(z_m > 0.0, np.rint(1e3 * FOCAL_BASELINE / disparity), 0.0).astype(np.uint16)


def _write(path: Path, **changes: object) -> Path:
    content: dict[str, Any] = {
        "mean_px": _distortion_px().astype(np.float32),
        "disparity_px_m": FOCAL_BASELINE,
        "model": "Kinect V1",
        "serial": "A1",
    } | changes
    np.savez(path, **content)
    return path


def _flatness_m(undistortion: Undistortion | None) -> tuple[float, float]:
    """Return bias and spread of a flat floor's heights, as a crooked sensor has it mapped."""
    mapper = Mapper(
        MapSettings(resolution_m=0.05, confirmations=1), NGUYEN_2012, undistortion=undistortion
    )
    mapper.add(mount())
    rotation = looking(0.0, 40.0)
    mapper.add(pose_sample(0, (0.0, 0.0, 0.8), rotation))
    z_m = plane_z(CAMERA, rotation, (0.0, 0.0, 1.0), -0.8)
    mapper.add(DepthFrame(0, _distorted_mm(np.where(z_m < 3.5, z_m, 0.0)), CAMERA, 0))
    mapper.finish()
    heights = mapper.elevation_map().elevation_m
    heights = heights[np.isfinite(heights)]
    return float(heights.mean()), float(heights.std())


def test_the_mapper_takes_the_distortion_off(tmp_path: Path) -> None:
    bias_m, spread_m = _flatness_m(None)
    assert bias_m > 2e-3
    assert spread_m > 1.5e-3
    bias_m, spread_m = _flatness_m(read_undistortion(_write(tmp_path / "u.npz")))
    assert abs(bias_m) < 2e-4
    assert spread_m < 4e-4  # whole millimetres


def test_distances_are_corrected_and_what_leaves_the_range_is_dropped(tmp_path: Path) -> None:
    undistortion = read_undistortion(_write(tmp_path / "u.npz"))
    true_m = np.full((120, 160), 2.0)
    true_m[:5] = 0.0
    true_m[-5:] = 2.9
    z_m = 1e-3 * _distorted_mm(true_m).astype(np.float32)
    assert np.abs(z_m - true_m).max() > 0.02
    assert undistortion.straighten(z_m, 0.5, 2.89) == 110 * 160
    np.testing.assert_allclose(z_m[5:-5], 2.0, atol=6e-4)
    assert not z_m[:5].any()
    assert not z_m[-5:].any()


def test_a_pixel_that_no_plate_reached_stays_as_it_is(tmp_path: Path) -> None:
    mean_px = _distortion_px()
    mean_px[:, :80] = np.nan
    undistortion = read_undistortion(_write(tmp_path / "u.npz", mean_px=mean_px))
    z_m = np.full((120, 160), 2.0, np.float32)
    undistortion.straighten(z_m, 0.5, 4.0)
    assert np.all(z_m[:, :80] == 2.0)
    assert z_m[0, 159] > 2.02


def test_what_the_plate_rig_measures_is_what_the_mapper_takes_off() -> None:
    """Same sign, same unit: residuals of one plate are the bowl less its plane."""
    frames = frames_of(Plate(1.0), 12, 0, KinectModel(), CAMERA)
    crooked = np.stack([_distorted_mm(1e-3 * frame.astype(np.float64)) for frame in frames])
    cell = CellEntry(recording="x", distance_m=1.0, angle_deg=0.0)
    # Intrinsics of a narrower image: the focal length scales, the baseline does not.
    outcome = analyse(CellFrames(crooked, CAMERA, DeviceIdentity(), ""), cell, Rig())
    seen = np.isfinite(outcome.residual_px)
    v, u = np.nonzero(seen)
    bowl = _distortion_px()[seen]
    columns = np.column_stack([u, v, np.ones(u.size)])
    bowl -= columns @ np.linalg.lstsq(columns, bowl, rcond=None)[0]
    slope = float(bowl @ outcome.residual_px[seen] / (bowl @ bowl))
    assert slope == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"mean_px": np.zeros(5)}, r"a map of shape \(5,\)"),
        ({"mean_px": np.full((4, 4), 90.0)}, "up to 90 px"),
        ({"disparity_px_m": 0.0}, "f b = 0 px m"),
        ({"disparity_px_m": "wide"}, "cannot read .*could not convert"),
        ({"mean_px": np.array([["a", "b"]])}, "cannot read .*isfinite"),
    ],
)
def test_what_is_no_distortion_is_refused(
    tmp_path: Path, changes: dict[str, object], words: str
) -> None:
    with pytest.raises(MappingError, match=words):
        read_undistortion(_write(tmp_path / "u.npz", **changes))


def test_other_files_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", mean_px=np.zeros((2, 2)))
    with pytest.raises(MappingError, match="has no disparity_px_m and no model and no serial"):
        read_undistortion(tmp_path / "other.npz")
    (tmp_path / "text.npz").write_text("mean_px")
    with pytest.raises(MappingError, match=r"cannot read .*text\.npz: no NumPy archive; expected"):
        read_undistortion(tmp_path / "text.npz")
    damaged, random = tmp_path / "damaged.npz", np.random.default_rng(1)
    np.savez_compressed(
        damaged, mean_px=random.random((64, 64)), disparity_px_m=1.0, model="", serial=""
    )
    content = damaged.read_bytes()
    damaged.write_bytes(content[:2000] + b"\xff" * 100 + content[2100:])
    with pytest.raises(MappingError, match=r"cannot read .*damaged\.npz"):
        read_undistortion(damaged)
    np.savez(tmp_path / "code.npz", mean_px=np.array([{}], dtype=object))
    with pytest.raises(MappingError):
        read_undistortion(tmp_path / "code.npz")


def test_another_camera_is_refused(tmp_path: Path) -> None:
    undistortion = read_undistortion(_write(tmp_path / "u.npz"))
    undistortion.check_device(DeviceIdentity(serial="A1"))
    undistortion.check_device(DeviceIdentity())
    with pytest.raises(MappingError, match=r"u\.npz was measured on Kinect V1 A1, .* is of K B2"):
        undistortion.check_device(DeviceIdentity(model="K", serial="B2"))
    with pytest.raises(MappingError, match=r"is for images of 160 x 120, .* 320 x 240"):
        undistortion.check_camera(CameraIntrinsics(320, 240, 290.0, 290.0, 159.5, 119.5))


def test_paper2019_takes_readings_as_they_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["map", "x.mcap", "-o", str(tmp_path / "x.nc"), "--method", "paper2019"]
    assert cli.main([*words, "--undistortion", str(_write(tmp_path / "u.npz"))]) == 2
    assert "leave --undistortion out" in capsys.readouterr().err
