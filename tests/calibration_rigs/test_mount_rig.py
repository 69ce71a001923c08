"""The camera's mount from a floor, and the effective track from turns, against known truth."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cli
from acquisition.importing import record_all
from acquisition.messages.frames import DEPTH_OPTICAL_FRAME, StaticTransform
from acquisition.stream.writer import StreamWriter
from calibration_rigs.errors import RigError
from calibration_rigs.mount_rig.camera import (
    MOUNT_KEYS,
    TABLE,
    CameraMount,
    calibrate_camera,
)
from calibration_rigs.mount_rig.floor import find_floor
from calibration_rigs.mount_rig.track import calibrate_track
from calibration_rigs.rover_block import check_block_target
from drivers.samples import DepthFrame, WheelTwistSample, YawRateSample, frozen_array
from drivers.source import SourceInfo
from mapping.geometry import RigidTransform
from mapping.noise import KINECT_V1
from tests.fakes.finite_source import FiniteSource
from tests.fakes.recordings import START_NS
from tests.mapping.scenes import CAMERA, looking, millimetres, plane_z

HEIGHT_M = 0.52
CROOKED_RAD = np.radians([0.7, -0.9])


def _true_mount() -> RigidTransform:
    """Return the camera 25 degrees down, then turned by the small angles that are to be found."""
    crooked = Rotation.from_rotvec([*CROOKED_RAD, 0.0]).as_matrix()
    return RigidTransform(crooked @ looking(), np.array([0.2, 0.0, HEIGHT_M]))


def _frames(count: int = 12, bias_sigmas: float = 0.0, box: bool = False) -> list[DepthFrame]:
    """Return noisy images of a flat floor under a camera with the true mount."""
    z_m = plane_z(CAMERA, _true_mount().rotation, (0.0, 0.0, -1.0), HEIGHT_M)
    z_m = np.where(z_m < 4.0, z_m, 0.0)
    if box:
        z_m[10:30, 40:] = np.where(z_m[10:30, 40:] > 0.0, 0.9, 0.0)
    rng = np.random.default_rng(3)
    images = []
    for number in range(count):
        noisy = z_m + bias_sigmas * KINECT_V1.bias_sigma_at_m(z_m)
        noisy += rng.normal(size=z_m.shape) * KINECT_V1.axial_sigma_m(
            np.maximum(z_m, 0.4), 0.0 * z_m
        )
        shown = millimetres(np.where(z_m > 0.0, np.maximum(noisy, 0.0), 0.0))
        images.append(DepthFrame(START_NS + number * 33_000_000, shown, CAMERA, number))
    return images


def _calibrate(frames: list[DepthFrame], parent_height_m: float | None = None) -> CameraMount:
    # The nominal mount is turned the other way: what is found is the turn back to the truth.
    nominal = RigidTransform(looking(), np.array([0.2, 0.0, 0.5]))
    return calibrate_camera(frames, nominal, "base_link", KINECT_V1, parent_height_m)


@pytest.mark.parametrize("box", [False, True])
def test_roll_pitch_and_height_are_found_within_their_sigma(box: bool) -> None:
    found = _calibrate(_frames(box=box))
    sigma = np.sqrt(np.diag(found.covariance))
    miss = np.array([found.roll_rad, found.pitch_rad]) - CROOKED_RAD
    assert np.all(np.abs(miss) < 3.0 * sigma[:2])
    assert abs(found.height_m - HEIGHT_M) < 3.0 * sigma[2]
    assert np.degrees(sigma[:2]).max() < 0.5
    up = found.T_parent_camera.rotation @ _true_mount().rotation.T @ [0.0, 0.0, 1.0]
    assert math.degrees(math.acos(up[2])) < 0.3
    assert found.misfit < 1.5


def test_a_bias_of_the_depth_is_within_the_sigma_although_the_images_agree() -> None:
    found = _calibrate(_frames(count=40, bias_sigmas=1.0))
    sigma = np.sqrt(np.diag(found.covariance))
    assert abs(found.height_m - HEIGHT_M) < 2.5 * sigma[2]
    assert abs(found.pitch_rad - CROOKED_RAD[1]) < 2.5 * sigma[1]


def test_the_camera_moves_only_where_the_parents_height_is_known() -> None:
    kept, measured = _calibrate(_frames()), _calibrate(_frames(), parent_height_m=0.1)
    assert kept.T_parent_camera.translation_m.tolist() == [0.2, 0.0, 0.5]
    assert measured.T_parent_camera.translation_m[2] == pytest.approx(HEIGHT_M - 0.1, abs=0.01)


def test_what_is_no_floor_is_refused() -> None:
    with pytest.raises(RigError, match="9 depth images; expected 10 or more"):
        _calibrate(_frames(9))
    wall = millimetres(np.full((CAMERA.height_px, CAMERA.width_px), 1.5))
    with pytest.raises(RigError, match="expected a flat floor below the camera"):
        find_floor(wall, CAMERA, KINECT_V1)
    with pytest.raises(RigError, match="usable depth readings"):
        find_floor(np.zeros_like(wall), CAMERA, KINECT_V1)
    rubble = np.random.default_rng(1).uniform(0.5, 3.0, wall.shape)
    with pytest.raises(RigError, match="the largest plane holds"):
        find_floor(millimetres(rubble), CAMERA, KINECT_V1)


def test_a_camera_that_moves_is_refused() -> None:
    tilted = plane_z(CAMERA, looking(pitch_deg=28.0), (0.0, 0.0, -1.0), HEIGHT_M)
    shown = millimetres(np.where(tilted < 4.0, tilted, 0.0))
    with pytest.raises(RigError, match="expected rover and camera at rest"):
        _calibrate([*_frames(), DepthFrame(START_NS, shown, CAMERA, 99)])


def _twists(tracks_m: list[float], angles_rad: list[float]) -> list[WheelTwistSample]:
    """Return turns of 4 s with 2 s of rest around them, at 50 Hz."""
    difference: list[float] = [0.0] * 100
    for track, angle in zip(tracks_m, angles_rad, strict=True):
        shape = np.sin(np.linspace(0.0, math.pi, 201)) ** 2 / 2.0  # integral over 4 s: 1
        difference += [*(shape * track * angle), *[0.0] * 100]
    return [
        WheelTwistSample(
            START_NS + i * 20_000_000, 0.0, 0.0, 0.1, 0.1, -float(d) / 2.0, float(d) / 2.0, i
        )
        for i, d in enumerate(difference)
    ]


def test_the_effective_track_is_found_with_the_scatter_of_the_turns() -> None:
    angles = [2.0 * math.pi, -2.0 * math.pi, 2.0 * math.pi]
    found = calibrate_track(_twists([0.55, 0.56, 0.57], angles), angles)
    assert found.track_m.value == pytest.approx(0.56, rel=2e-3)
    assert found.track_m.sigma == pytest.approx(0.01 / math.sqrt(3.0), rel=0.05)
    assert found.per_turn_m == pytest.approx([0.55, 0.56, 0.57], rel=2e-3)


def test_one_turn_gives_no_sigma_and_wrong_angles_are_refused() -> None:
    twists = _twists([0.55], [math.pi])
    assert "one turn: no sigma" in calibrate_track(twists, [math.pi]).describe()[0]
    with pytest.raises(RigError, match="1 turns with rest around them and 2 known angles"):
        calibrate_track(twists, [math.pi, math.pi])
    with pytest.raises(RigError, match="counter-clockwise is positive"):
        calibrate_track(twists, [-math.pi])
    with pytest.raises(RigError, match="no speeds of left and right wheels"):
        calibrate_track([], [math.pi])


@pytest.mark.parametrize(("first", "last"), [(150, 190), (90, 130)])
def test_a_turn_with_wheel_speeds_missing_is_refused(first: int, last: int) -> None:
    """Within the turn, or over its beginning."""
    twists = _twists([0.55, 0.55], [math.pi, math.pi])
    whole = calibrate_track(twists[:60] + twists[90:], [math.pi, math.pi])  # missing at rest
    assert whole.track_m.value == pytest.approx(0.55, rel=2e-3)
    with pytest.raises(RigError, match=r"turn 1 has no wheel speeds for 0\.82 s; expected"):
        calibrate_track(twists[:first] + twists[last:], [math.pi, math.pi])
    with pytest.raises(RigError, match=r"3 turns .*; the wheels have no samples for 1\.22 s"):
        calibrate_track(twists[:150] + twists[210:], [math.pi, math.pi])


def _gyro(angles_rad: list[float], bias_rad_s: float = 0.02) -> list[YawRateSample]:
    """Return what a gyro sees of the turns of `_twists`, its axis down, at 50 Hz."""
    wheels = _twists([1.0] * len(angles_rad), angles_rad)
    return [
        YawRateSample(s.t_ns, bias_rad_s - 2.0 * (s.right_m_s or 0.0), None, 0, s.sequence)
        for s in wheels
    ]


def test_angles_that_the_gyro_did_not_see_are_refused() -> None:
    angles = [2.0 * math.pi, -2.0 * math.pi]
    twists = _twists([0.55, 0.55], angles)
    found = calibrate_track(twists, angles, gyro=_gyro([0.95 * a for a in angles]))
    assert found.track_m.value == pytest.approx(0.55, rel=2e-3)
    with pytest.raises(RigError, match="turn 2 is stated as -360 degrees and the gyro saw 270"):
        calibrate_track(twists, angles, gyro=_gyro([2.0 * math.pi, -1.5 * math.pi]))
    # A gyro that was not there for the turns confirms and refuses nothing.
    assert calibrate_track(twists, angles, gyro=_gyro([0.0])[:50]) == calibrate_track(
        twists, angles
    )


@pytest.mark.parametrize("times", [0.3, 2.1])
def test_a_track_far_from_the_one_in_use_is_refused(times: float) -> None:
    angle = 2.0 * math.pi
    twists = [
        replace(s, yaw_rate_rad_s=2.0 * (s.right_m_s or 0.0) / 0.55)
        for s in _twists([0.55], [angle])
    ]
    assert calibrate_track(twists, [angle]).per_turn_m == pytest.approx([0.55], rel=2e-3)
    with pytest.raises(RigError, match=r"0\.550 m in use; expected 0\.18 to 1\.10 m"):
        calibrate_track(twists, [angle / times])


def test_a_drive_that_is_no_turn_is_one_line_and_exit_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = tmp_path / "drive.mcap"
    rover = SourceInfo("rover", "", "", (WheelTwistSample, YawRateSample), "recorded")
    with (
        recording.open("wb") as stream,
        StreamWriter(stream, sources=[rover], static_transforms=(), settings={}) as writer,
    ):
        for pair in zip(_twists([0.55], [-1.0]), _gyro([-1.0]), strict=True):
            for sample in pair:
                writer.write(sample)
    assert cli.main(["calibrate", "track", str(recording), "--turns-deg=-1"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "turn 1 is stated as -1 degrees and the gyro saw 57.3; expected" in line
    assert cli.main(["calibrate", "track", str(recording), "--turns-deg=-57.3"]) == 0


def test_the_command_writes_a_block_that_rover_toml_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    x, y, z, w = Rotation.from_matrix(looking()).as_quat()
    mount = StaticTransform(
        "base_link",
        DEPTH_OPTICAL_FRAME,
        frozen_array((0.2, 0.0, 0.5), (3,)),
        frozen_array((w, x, y, z), (4,)),
    )
    recording, output = tmp_path / "floor.mcap", tmp_path / "mount.toml"
    record_all(FiniteSource(_frames()), recording, static_transforms=[mount], settings={})
    assert cli.main(["calibrate", "mount", str(recording), "-o", str(output)]) == 0
    assert "not observed, as before: heading" in capsys.readouterr().out
    rover = tmp_path / "rover.toml"
    rover.write_text(output.read_text())
    assert cli.main(["config", "show", str(rover)]) == 0
    check_block_target(output, TABLE, MOUNT_KEYS)  # it may be made anew


def test_a_recording_without_turns_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = tmp_path / "floor.mcap"
    record_all(FiniteSource(_frames(2)), recording, static_transforms=[], settings={})
    assert cli.main(["calibrate", "track", str(recording), "--turns-deg", "360"]) == 2
    assert cli.main(["calibrate", "mount", str(recording), "-o", str(tmp_path / "m.toml")]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 2
    assert not (tmp_path / "m.toml").exists()
