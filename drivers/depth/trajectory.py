"""The text files of a TUM RGB-D folder: stamped lines, and camera poses between them.

Format (Sturm et al. 2012, "A Benchmark for the Evaluation of RGB-D SLAM Systems"): one item per
line, `#` starts a comment, the first column is the time in seconds as decimal text.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from drivers.errors import DriverError, reason_of
from drivers.samples import Float64Array

Int64Array = NDArray[np.int64]

# Decimal seconds; the exponent form is what numpy.savetxt, and so evo, writes.
_STAMP = re.compile(r"\d{1,19}(\.\d{0,40})?([eE][+-]?\d{1,2})?", re.ASCII)

# No position or acceleration in SI units is larger, and squares stay far from overflow.
_LARGEST = 1e12

UNIT_TOLERANCE = 1e-2  # four printed decimals leave 1e-4; more than this is not a rotation

# Two poses with one printed stamp are kept as one when they agree this well. Published TUM files
# hold such pairs (3 of 21823 lines in fr2/pioneer_360; up to 1.6 mm and 0.4 deg apart).
_REPEAT_LIMIT_M = 0.010
_REPEAT_LIMIT_RAD = np.radians(1.0)


def parse_stamp_ns(text: str) -> int:
    """Return decimal seconds as integer nanoseconds, without a float on the way.

    Digits finer than a nanosecond are rounded, half to even.

    Raises:
        ValueError: not a non-negative decimal number, or beyond 64 bits.
    """
    if _STAMP.fullmatch(text) is None:
        raise ValueError(f"{text!r} is not a time in decimal seconds")
    t_ns = round(Fraction(text) * 10**9)
    if t_ns >= 2**63:
        raise ValueError(f"{text!r} is more seconds than 64 bits of nanoseconds hold")
    return t_ns


@dataclass(frozen=True, slots=True)
class Row:
    """One line: where it stands, its time, and the text of the other columns."""

    line: int
    t_ns: int
    rest: str


def read_rows(path: Path, columns: str, *, repeats: bool = False) -> list[Row]:
    """Return the stamped lines of a file, which must be in time order.

    Args:
        path: the file.
        columns: the names of its columns, for the messages.
        repeats: whether a stamp may occur twice.

    Raises:
        DriverError: unreadable, empty, malformed, or out of order.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DriverError(
            f"cannot read {path}: {reason_of(error)}; expected a text file with columns {columns}"
        ) from error
    rows: list[Row] = []
    for line, content in enumerate(text.splitlines(), start=1):
        content = content.strip()
        if not content or content.startswith("#"):
            continue
        row = _parse_row(path, line, content, columns)
        if rows and (row.t_ns < rows[-1].t_ns or (row.t_ns == rows[-1].t_ns and not repeats)):
            raise DriverError(
                f"{path}:{line}: stamp {content.split()[0]} is not later than the one of line "
                f"{rows[-1].line}; expected increasing stamps, sort the file and drop repeats"
            )
        rows.append(row)
    if not rows:
        raise DriverError(
            f"{path} has no lines besides comments; expected columns {columns}, restore the file"
        )
    return rows


def _parse_row(path: Path, line: int, content: str, columns: str) -> Row:
    stamp, *rest = content.split(maxsplit=1)
    try:
        t_ns = parse_stamp_ns(stamp)
    except ValueError as error:
        raise DriverError(
            f"{path}:{line}: {error}; expected columns {columns}, mend the line"
        ) from error
    return Row(line, t_ns, rest[0] if rest else "")


def read_table(
    path: Path, columns: str, *, repeats: bool = False
) -> tuple[list[Row], Float64Array]:
    """Return the lines of a file and, as (N, number of columns - 1), their finite numbers.

    Raises:
        DriverError: as `read_rows`, or a column is missing, too many, no number, NaN or infinite.
    """
    rows = read_rows(path, columns, repeats=repeats)
    width = len(columns.split()) - 1
    values = np.empty((len(rows), width))
    for index, row in enumerate(rows):
        numbers = _numbers(row.rest)
        if len(numbers) != width:
            raise DriverError(
                f"{path}:{row.line}: found {row.rest!r} after the stamp; expected finite numbers "
                f"{columns.removeprefix('stamp ')}, mend or drop the line"
            )
        values[index] = numbers
    return rows, values


def _numbers(text: str) -> list[float]:
    """Return the numbers of a text, or nothing when one of its fields is none to work with."""
    if "_" in text:  # float() would read 1_0 as 10
        return []
    try:
        numbers = [float(field) for field in text.split()]
    except ValueError:
        return []
    return numbers if all(abs(number) < _LARGEST for number in numbers) else []


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Poses of a camera in a world frame, at strictly increasing times.

    Attributes:
        path: the file they came from.
        t_ns: (N,) int64.
        position_m: (N, 3) origin of the camera in the world.
        quat_xyzw: (N, 4) unit quaternions, camera axes to world axes.
    """

    path: Path
    t_ns: Int64Array
    position_m: Float64Array
    quat_xyzw: Float64Array


def read_trajectory(path: Path) -> Trajectory:
    """Read `stamp tx ty tz qx qy qz qw` lines; quaternions come back normalised.

    A pose that repeats the stamp of the one before is left out when the two agree.

    Raises:
        DriverError: as `read_table`, or a quaternion is not a rotation, or two poses with one
            stamp contradict each other.
    """
    rows, values = read_table(path, "stamp tx ty tz qx qy qz qw", repeats=True)
    lines = [row.line for row in rows]
    norms = np.linalg.norm(values[:, 3:], axis=1)
    wrong = np.flatnonzero(np.abs(norms - 1.0) > UNIT_TOLERANCE)
    if wrong.size:
        raise DriverError(
            f"{path}:{lines[wrong[0]]}: quaternion of length {norms[wrong[0]]:.4g} "
            f"({wrong.size} such lines); expected 1 within {UNIT_TOLERANCE}, order qx qy qz qw"
        )
    t_ns = np.array([row.t_ns for row in rows], dtype=np.int64)
    position_m, quat_xyzw = values[:, :3], values[:, 3:] / norms[:, None]
    first = np.concatenate([[True], np.diff(t_ns) > 0])
    _check_repeats(path, lines, position_m, quat_xyzw, np.flatnonzero(~first))
    return Trajectory(path, t_ns[first], position_m[first], quat_xyzw[first])


def _check_repeats(
    path: Path,
    lines: Sequence[int],
    position_m: Float64Array,
    quat_xyzw: Float64Array,
    repeated: NDArray[np.intp],
) -> None:
    """Refuse a pose that repeats the stamp of the line before but says something else."""
    apart_m = np.linalg.norm(position_m[repeated] - position_m[repeated - 1], axis=1)
    cosine = np.abs(np.sum(quat_xyzw[repeated] * quat_xyzw[repeated - 1], axis=1))
    apart_rad = 2.0 * np.arccos(np.minimum(cosine, 1.0))
    bad = np.flatnonzero((apart_m > _REPEAT_LIMIT_M) | (apart_rad > _REPEAT_LIMIT_RAD))
    if bad.size:
        raise DriverError(
            f"{path}:{lines[repeated[bad[0]]]}: repeats the stamp of the line before with a pose "
            f"{apart_m[bad[0]]:.3g} m and {np.degrees(apart_rad[bad[0]]):.3g} deg away; "
            "expected one pose per stamp, drop one of the two"
        )


def interpolate(
    trajectory: Trajectory, t_ns: Int64Array, max_gap_s: float
) -> tuple[Float64Array, Float64Array, NDArray[np.bool_]]:
    """Return the poses at the given times.

    A pose exactly at a time is used as it is, whatever its neighbours. Between two poses the
    position is linear and the rotation spherical-linear, if they are at most `max_gap_s` apart.

    Args:
        trajectory: N poses.
        t_ns: (M,) times, ns.
        max_gap_s: the longest time between two poses that is bridged.

    Returns:
        position_m (M, 3), quat_wxyz (M, 4), and known (M,) which is False where the trajectory
        says nothing about that time; the other two are NaN there.
    """
    after = np.searchsorted(trajectory.t_ns, t_ns)
    last = len(trajectory.t_ns) - 1
    right = np.minimum(after, last)
    left = np.maximum(right - 1, 0)
    exact = trajectory.t_ns[right] == t_ns
    gap_ns = trajectory.t_ns[right] - trajectory.t_ns[left]
    between = ~exact & (after > 0) & (after <= last) & (gap_ns <= round(max_gap_s * 1e9))

    position_m = np.full((len(t_ns), 3), np.nan)
    quat_xyzw = np.full((len(t_ns), 4), np.nan)
    position_m[exact] = trajectory.position_m[right[exact]]
    quat_xyzw[exact] = trajectory.quat_xyzw[right[exact]]
    if between.any():
        i, j = left[between], right[between]
        part = ((t_ns[between] - trajectory.t_ns[i]) / gap_ns[between])[:, None]
        ends = trajectory.position_m[i], trajectory.position_m[j]
        position_m[between] = (1.0 - part) * ends[0] + part * ends[1]
        elapsed_ns = (trajectory.t_ns - trajectory.t_ns[0]).astype(np.float64)
        slerp = Slerp(elapsed_ns, Rotation.from_quat(trajectory.quat_xyzw))
        wanted_ns = (t_ns[between] - trajectory.t_ns[0]).astype(np.float64)
        quat_xyzw[between] = slerp(wanted_ns).as_quat()
    return position_m, quat_xyzw[:, [3, 0, 1, 2]], exact | between
