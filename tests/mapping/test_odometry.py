"""Trajectories: files, alignment, ATE, RPE and NEES by hand, and the commands."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cli
from acquisition.messages.frames import StaticTransform, StaticTransforms
from acquisition.stream.writer import StreamWriter
from drivers.samples import AccelerationSample, PoseSample, WheelTwistSample, YawRateSample
from drivers.source import SourceInfo
from mapping.errors import MappingError
from mapping.geometry import Float64Array, RigidTransform, UncertainPose
from mapping.judging.odometry import evaluate_odometry, relative_errors, yaw_errors
from mapping.judging.odometry_scores import Alignment
from mapping.judging.trajectory import Path3D, read_path, write_path
from mapping.output.figure_odometry import write_odometry_figures
from tests.mapping.ego_motion.drives import START_NS, Drive

KINDS = (AccelerationSample, YawRateSample, WheelTwistSample)


def about_z(angles: Float64Array) -> Rotation:
    return Rotation.from_rotvec(np.outer(angles, [0.0, 0.0, 1.0]))


def path(count: int = 41, turn: float = 0.0, scale: float = 1.0) -> Path3D:
    """Return 4 m in 20 s along a wavy way, turned about z and stretched."""
    t = np.linspace(0.0, 20.0, count)
    way = np.column_stack([0.2 * t, 0.3 * np.sin(0.4 * t), 0.1 * np.sin(0.2 * t)])
    heading = about_z(0.3 * np.cos(0.4 * t))
    whole = Rotation.from_rotvec([0.0, 0.0, turn])
    t_ns = START_NS + np.rint(1e9 * t).astype(np.int64)
    return Path3D("made up", t_ns, whole.apply(scale * way), whole * heading)


@pytest.mark.parametrize("alignment", ["start", "yaw", "se3"])
def test_a_turned_copy_is_no_error(alignment: Alignment) -> None:
    true, estimate = path(401), path(401, turn=1.0)
    scores = evaluate_odometry(estimate, true, alignment)
    assert scores.ate_m.largest < 1e-9
    assert scores.ate_yaw_deg.largest < 1e-6
    assert scores.per_metre_m.largest < 1e-9
    assert scores.nees is None
    apart = evaluate_odometry(estimate, true, "none").ate_m
    assert apart.largest == pytest.approx(
        np.linalg.norm(estimate.position_m - true.position_m, axis=1).max()
    )


def test_a_stretched_way_is_off_by_its_share() -> None:
    scores = evaluate_odometry(path(2001, scale=1.02), path(2001), "start")
    assert scores.per_metre_m.median == pytest.approx(0.02, rel=0.05)
    assert scores.per_second_m.count == 20
    assert scores.per_second_deg.largest < 1e-9
    assert scores.ate_m.largest == pytest.approx(0.02 * 4.0, rel=0.1)


def test_relative_errors_by_hand() -> None:
    true = Path3D(
        "t", np.arange(3), np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), Rotation.identity(3)
    )
    turned = about_z(np.array([0.0, 0.1, 0.1]))
    estimate = Path3D("e", true.t_ns, np.array([[0.0, 0, 0], [1.1, 0, 0], [2.1, 0, 0]]), turned)
    moved, angle = relative_errors(estimate, true, np.array([0.0, 1.0, 2.0]), 1.0)
    np.testing.assert_allclose(angle, [0.1, 0.0], atol=1e-12)
    # The second step is one metre along x, seen from a body that is turned by 0.1.
    np.testing.assert_allclose(moved, [0.1, 2.0 * np.sin(0.05)], atol=1e-12)
    assert relative_errors(estimate, true, np.array([0.0, 0.1, 0.2]), 1.0)[0].size == 0


def test_nees_is_one_for_errors_of_one_sigma() -> None:
    true = path(401)
    sigma = np.array([0.01, 0.02, 0.03, 0.05])
    covariance = np.zeros((401, 6, 6))
    covariance[:, [0, 1, 2, 5], [0, 1, 2, 5]] = sigma**2
    shift = np.vstack([np.zeros(3), np.tile(sigma[:3], (400, 1))])
    turn = about_z(np.r_[0.0, np.full(400, sigma[3])])
    estimate = Path3D("e", true.t_ns, true.position_m + shift, turn * true.rotation, covariance)
    scores = evaluate_odometry(estimate, true)
    np.testing.assert_allclose(scores.nees_values[1:], 1.0, rtol=1e-4)
    assert scores.nees is not None
    assert scores.nees.inside_95 == 1.0
    np.testing.assert_allclose(yaw_errors(estimate, true)[1:], 0.05, atol=1e-12)


def test_truth_between_its_poses_is_interpolated_and_gaps_are_not() -> None:
    fine, coarse = path(401), path(201)
    scores = evaluate_odometry(fine, coarse, "none")
    assert scores.poses == 401
    assert scores.ate_m.largest < 1e-3
    with pytest.raises(MappingError, match="times in common"):
        evaluate_odometry(path(11), path(11, turn=0.1).at(path(2).t_ns, 100.0)[0])


def poses() -> list[UncertainPose]:
    way = path(5)
    return [
        UncertainPose(
            int(way.t_ns[i]),
            RigidTransform(way.rotation[i].as_matrix(), way.position_m[i]),
            np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) * 1e-6,
        )
        for i in range(len(way))
    ]


@pytest.mark.parametrize("name", ["est.tum", "est.nc"])
def test_files_give_back_what_was_written(tmp_path: Path, name: str) -> None:
    write_path(tmp_path / name, poses())
    found = read_path(tmp_path / name)
    np.testing.assert_array_equal(found.t_ns, path(5).t_ns)
    np.testing.assert_allclose(found.position_m, path(5).position_m, atol=1e-9)
    assert (found.rotation * path(5).rotation.inv()).magnitude().max() < 1e-8
    assert (found.covariance is None) == name.endswith("tum")


def test_files_that_hold_no_trajectory(tmp_path: Path) -> None:
    with pytest.raises(MappingError, match="nothing to write"):
        write_path(tmp_path / "est.tum", [])
    write_path(tmp_path / "one.tum", poses()[:1])
    with pytest.raises(MappingError, match="two or more"):
        read_path(tmp_path / "one.tum")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of a short drive with its true poses."""
    drive = Drive(seconds=5.0)
    file = tmp_path_factory.mktemp("odometry") / "drive.mcap"
    info = SourceInfo("rover", "made up", "", (*KINDS, PoseSample), "recorded", {}, {})
    mount = StaticTransform("mocap_body", "base_link", np.zeros(3), np.array([1.0, 0, 0, 0]))
    with StreamWriter(file, sources=[info], static_transforms=[mount], settings={}) as writer:
        for sample in drive.samples():
            writer.write(sample)
        for index, seconds in enumerate(np.arange(0.0, 4.9, 0.02).tolist()):
            x, y, yaw = drive.truth(np.array([seconds]))[0]
            quat = Rotation.from_euler("z", yaw).as_quat(scalar_first=True)
            t_ns = START_NS + round(1e9 * seconds)
            writer.write(PoseSample(t_ns, np.array([x, y, 0.0]), quat, np.eye(6) * 1e-6, index))
    return file


def test_the_commands_follow_and_judge_a_recording(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    estimate = str(tmp_path / "est.nc")
    delays = [f"--set={name}_delay_s=0" for name in ("gyro", "wheels", "acceleration")]
    assert cli.main(["odometry", str(recording), "-o", estimate, *delays]) == 0
    assert "horizontal sigma" in capsys.readouterr().out
    judged = ["evaluate", "odometry", estimate, str(recording)]
    assert cli.main([*judged, "--json", "--figures", str(tmp_path)]) == 0
    scores = json.loads(capsys.readouterr().out)
    assert scores["ate_m"]["rmse"] < 0.01
    assert scores["nees_inside_95"] > 0.9
    assert (tmp_path / "drift.png").stat().st_size > 10_000
    assert cli.main(judged) == 0
    assert "NEES/dof" in capsys.readouterr().out


def test_the_papers_way_is_a_point_and_says_so(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    estimate = str(tmp_path / "est.tum")
    words = ["odometry", str(recording), "-o", estimate, "--method", "paper2019", "--json"]
    assert cli.main(words) == 0
    told = capsys.readouterr()
    assert "no velocity state" in told.err
    found = read_path(tmp_path / "est.tum")
    said = json.loads(told.out)
    assert said["output"] == estimate
    assert said["poses"] == len(found.t_ns)
    assert said["end_m"] == pytest.approx(found.position_m[-1].tolist(), abs=1e-6)
    assert said["duration_s"] == pytest.approx((found.t_ns[-1] - found.t_ns[0]) * 1e-9, abs=1e-6)
    assert np.abs(found.position_m).max() < 0.01


def test_recorded_poses_count_when_they_are_asked_for(recording: Path, tmp_path: Path) -> None:
    estimate = tmp_path / "est.nc"
    arguments = ["odometry", str(recording), "-o", str(estimate), "--with-poses"]
    assert cli.main([*arguments, "--without-wheels", "--set", "acceleration_delay_s=0"]) == 0
    found = read_path(estimate)
    assert found.covariance is not None
    assert found.covariance[-1, 0, 0] ** 0.5 < 0.01


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evaluate", "odometry", "a.tum"], "expected EST and TRUTH"),
        (["evaluate", "odometry", "a.tum", "b.tum", "--origin", "start"], "are for maps"),
        (["evaluate", "map.nc"], "give one map with --truth"),
        (["odometry", "x.mcap", "-o", "y.tum", "--set", "nothing=1"], "no NAME=VALUE"),
        (["odometry", "x.mcap", "-o", "y.tum", "--set", "slip=much"], "expected a number"),
    ],
)
def test_wrong_usage_is_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(arguments) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_figures_go_where_they_are_told(tmp_path: Path) -> None:
    scores = evaluate_odometry(path(41, scale=1.02), path(401))
    files = write_odometry_figures(scores, tmp_path / "new")
    assert [file.name for file in files] == ["path.png", "drift.png"]


def test_static_transforms_move_recorded_poses_to_the_rover(tmp_path: Path) -> None:
    file = tmp_path / "poses.mcap"
    info = SourceInfo("mocap", "made up", "", (PoseSample,), "recorded", {}, {})
    mount = StaticTransform(
        "mocap_body", "base_link", np.array([0.0, 0.0, -0.5]), np.array([1.0, 0, 0, 0])
    )
    message = StaticTransforms(START_NS, (mount,))
    with StreamWriter(
        file, sources=[info], static_transforms=list(message.transforms), settings={}
    ) as writer:
        for index in range(3):
            writer.write(
                PoseSample(
                    START_NS + index * 10**7,
                    np.array([1.0, 2.0, 3.0]),
                    np.array([1.0, 0.0, 0.0, 0.0]),
                    np.zeros((6, 6)),
                    index,
                )
            )
    np.testing.assert_allclose(read_path(file).position_m, np.tile([1.0, 2.0, 2.5], (3, 1)))
