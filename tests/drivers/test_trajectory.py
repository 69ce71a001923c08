"""The text files of a TUM folder: exact stamps, malformed lines, and poses between poses."""

from __future__ import annotations

import contextlib
import gzip
import re
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.depth.trajectory import (
    Trajectory,
    interpolate,
    parse_stamp_ns,
    read_rows,
    read_table,
    read_trajectory,
)
from drivers.errors import DriverError

POSE_COLUMNS = "stamp tx ty tz qx qy qz qw"
same_folder = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


def write(folder: Path, text: str) -> Path:
    path = folder / "file.txt"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "t_ns"),
    [
        ("1341841278.842700", 1341841278842700000),  # the first stamp of fr3/cabinet
        ("1341841278.842700123", 1341841278842700123),  # a float would end in ...717
        ("0", 0),
        ("7.", 7_000_000_000),
        ("1.305031102175304174e+09", 1305031102175304174),  # numpy.savetxt, evo
        ("0.0000000005", 0),  # halves to even
        ("0.0000000015", 2),
        ("9223372036.854775807", 2**63 - 1),
    ],
)
def test_stamp_is_exact(text: str, t_ns: int) -> None:
    assert parse_stamp_ns(text) == t_ns


@pytest.mark.parametrize(
    "text", ["", "-1", "nan", "inf", "1_0", "0x10", "1/2", "1e999", "9223372036.854775808", "1,5"]
)
def test_stamp_refuses(text: str) -> None:
    with pytest.raises(ValueError, match=re.escape(repr(text))):
        parse_stamp_ns(text)


@given(st.integers(0, 2**63 - 1), st.integers(0, 4))
def test_stamp_round_trip(t_ns: int, zeros: int) -> None:
    assert parse_stamp_ns(f"{t_ns // 10**9}.{t_ns % 10**9:09d}{'0' * zeros}") == t_ns
    assert parse_stamp_ns(f"{Decimal(t_ns).scaleb(-9):e}") == t_ns


@given(st.text(max_size=30))
def test_stamp_never_fails_otherwise(text: str) -> None:
    with contextlib.suppress(ValueError):
        assert 0 <= parse_stamp_ns(text) < 2**63


def test_rows_skip_comments_and_keep_line_numbers(tmp_path: Path) -> None:
    path = write(tmp_path, "# head\n\n 1.5  a b.png \n#tail\n2 c.png\n")
    rows = read_rows(path, "stamp filename")
    assert [(row.line, row.t_ns, row.rest) for row in rows] == [
        (3, 1_500_000_000, "a b.png"),
        (5, 2_000_000_000, "c.png"),
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 0 0 0 0 0 0 1\nx 0 0 0 0 0 0 1", "file.txt:2: 'x' is not a time"),
        ("1 0 0 0 0 0 0", "file.txt:1: found '0 0 0 0 0 0' after the stamp"),
        ("1 0 0 0 0 0 0 1 9", "file.txt:1: found"),
        ("1 0 0 zero 0 0 0 1", "file.txt:1: found"),
        ("1 0 0 1_0 0 0 0 1", "file.txt:1: found"),
        ("1 0 0 nan 0 0 0 1", "file.txt:1: found"),
        ("1 0 0 0 0 0 0 inf", "file.txt:1: found"),
        ("1 0 0 0 0 0 0 0", "file.txt:1: quaternion of length 0 "),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1.011", "file.txt:2: quaternion of length 1.011 "),
        ("1 0 0 0 1e200 0 0 1e200", "file.txt:1: found"),
        ("2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1", "file.txt:2: stamp 1 is not later"),
        ("1 0 0 0 0 0 0 1\n1 0 0 0.011 0 0 0 1", "file.txt:2: repeats the stamp"),
        ("1 0 0 0 0 0 0 1\n1 0 0 0 0.01 0 0 1", "file.txt:2: repeats the stamp"),
        ("# nothing\n", "no lines besides comments"),
        ("", "no lines besides comments"),
    ],
)
def test_trajectory_refuses(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(DriverError, match=message) as caught:
        read_trajectory(write(tmp_path, text))
    assert "\n" not in str(caught.value)
    assert "expected" in str(caught.value)


def test_rows_refuse_a_repeated_stamp(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match=r"file.txt:2: stamp 1.0 is not later .* line 1"):
        read_rows(write(tmp_path, "1 a\n1.0 b\n"), "stamp filename")


def test_unreadable_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    with pytest.raises(DriverError, match=r"cannot read .*file\.txt"):
        read_rows(path, "stamp filename")
    path.write_bytes(b"1 \xff\n")
    with pytest.raises(DriverError, match=r"cannot read .*file\.txt"):
        read_rows(path, "stamp filename")


@same_folder
@given(text=st.text(alphabet="0123456789.eE+-# \nnaif_", max_size=80))
def test_table_gives_finite_numbers_or_a_driver_error(tmp_path: Path, text: str) -> None:
    path = write(tmp_path, text)
    with contextlib.suppress(DriverError):
        rows, values = read_table(path, "stamp ax ay az")
        assert values.shape == (len(rows), 3)
        assert np.isfinite(values).all()
        assert (np.diff([row.t_ns for row in rows]) > 0).all()


coordinate = st.floats(-1e3, 1e3)
unit_quaternion = (
    st.tuples(*[st.floats(-1, 1)] * 4)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)


@same_folder
@given(
    poses=st.lists(st.tuples(st.tuples(*[coordinate] * 3), unit_quaternion), min_size=1, max_size=5)
)
def test_trajectory_round_trip(
    tmp_path: Path, poses: list[tuple[tuple[float], np.ndarray]]
) -> None:
    lines = [
        " ".join([f"{index}.000000001", *map(repr, position), *map(repr, quat.tolist())])
        for index, (position, quat) in enumerate(poses)
    ]
    trajectory = read_trajectory(write(tmp_path, "\n".join(lines)))
    assert trajectory.t_ns.tolist() == [index * 10**9 + 1 for index in range(len(poses))]
    np.testing.assert_array_equal(trajectory.position_m, [position for position, _ in poses])
    np.testing.assert_allclose(trajectory.quat_xyzw, [quat for _, quat in poses], atol=1e-15)


def test_repeated_stamp_keeps_the_first_pose(tmp_path: Path) -> None:
    # Lines of fr2/pioneer_slam: same printed stamp, 1.5 mm apart, quaternion of other sign.
    path = write(
        tmp_path,
        "1311878198.3601 -2.0367 -2.1655 0.5890 0.5242 -0.5240 0.4776 -0.4717\n"
        "1311878198.3601 -2.0352 -2.1655 0.5893 -0.5219 0.5239 -0.4793 0.4727\n",
    )
    trajectory = read_trajectory(path)
    assert trajectory.position_m.tolist() == [[-2.0367, -2.1655, 0.5890]]


def turning(t_s: list[float]) -> Trajectory:
    """Return poses that move along x at 1 m/s and turn about z at 1 rad/s."""
    t = np.array(t_s)
    zero = np.zeros_like(t)
    return Trajectory(
        Path("poses.txt"),
        np.rint(t * 1e9).astype(np.int64),
        np.stack([t, zero, zero], axis=1),
        np.stack([zero, zero, np.sin(t / 2), np.cos(t / 2)], axis=1),
    )


def test_interpolation_is_linear_in_position_and_angle() -> None:
    t_s = np.array([0.0, 0.03, 0.1, 0.17])
    position_m, quat_wxyz, known = interpolate(
        turning([0.0, 0.1, 0.2]), np.rint(t_s * 1e9).astype(np.int64), max_gap_s=0.1
    )
    assert known.all()
    np.testing.assert_allclose(position_m[:, 0], t_s, atol=1e-12)
    np.testing.assert_allclose(quat_wxyz[:, 0], np.cos(t_s / 2), atol=1e-12)
    np.testing.assert_allclose(quat_wxyz[:, 3], np.sin(t_s / 2), atol=1e-12)


def test_an_exact_pose_is_used_unchanged_whatever_the_gap() -> None:
    trajectory = turning([0.0, 0.7, 1.3])
    position_m, quat_wxyz, known = interpolate(trajectory, trajectory.t_ns, max_gap_s=0.1)
    assert known.all()
    np.testing.assert_array_equal(position_m, trajectory.position_m)
    np.testing.assert_array_equal(quat_wxyz[:, [1, 2, 3, 0]], trajectory.quat_xyzw)


def test_unknown_outside_and_in_long_gaps() -> None:
    t_ns = np.array([999_999_999, 1_050_000_000, 1_200_000_000, 1_500_000_001], dtype=np.int64)
    position_m, _, known = interpolate(turning([1.0, 1.1, 1.5]), t_ns, max_gap_s=0.1)
    assert known.tolist() == [False, True, False, False]
    assert np.isnan(position_m[~known]).all()
    *_, known = interpolate(turning([1.0, 1.1, 1.5]), t_ns, max_gap_s=0.4)
    assert known.tolist() == [False, True, True, False]


def test_a_single_pose_answers_for_its_own_time_only() -> None:
    *_, known = interpolate(turning([1.0]), np.array([10**9, 10**9 + 1]), max_gap_s=10.0)
    assert known.tolist() == [True, False]


@pytest.mark.parametrize(("sequence", "poses"), [("360", 21823 - 3), ("slam", 44212 - 10)])
def test_published_ground_truth_with_repeated_stamps(
    real_data: Path, tmp_path: Path, sequence: str, poses: int
) -> None:
    name = f"rgbd_dataset_freiburg2_pioneer_{sequence}_groundtruth.txt.gz"
    text = gzip.decompress((real_data / "tum_fr2_pioneer" / name).read_bytes()).decode()
    trajectory = read_trajectory(write(tmp_path, text))
    assert len(trajectory.t_ns) == poses
    assert (np.diff(trajectory.t_ns) > 0).all()
