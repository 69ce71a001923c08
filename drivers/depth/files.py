"""Two layouts of depth image folders: TUM RGB-D, and plain PNGs in millimetres."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from pathlib import Path

from drivers.checks import check_positive
from drivers.depth.folder import (
    MAX_POSE_GAP_S,
    POSE_SIGMA_M,
    POSE_SIGMA_RAD,
    DepthFolder,
    DepthImage,
    FramesWithoutPose,
    Listing,
    PoseSettings,
)
from drivers.depth.trajectory import parse_stamp_ns, read_rows, read_table
from drivers.errors import DriverError
from drivers.samples import AccelerationSample, frozen_array

_FRAME_NUMBER = re.compile(r"\d{1,15}", re.ASCII)
_NANOSECONDS = re.compile(r"\d{16,19}", re.ASCII)


class TumFolder(DepthFolder):
    """A folder in the layout of the TUM RGB-D benchmark.

    `depth.txt` (stamp, file name) lists the images, `groundtruth.txt` (stamp tx ty tz qx qy qz
    qw) is the camera in the world, and `accelerometer.txt` (stamp ax ay az, m/s^2) may be there.
    Files as published can be used unchanged, if uncompressed.

    Args:
        folder: the folder with these files.
        intrinsics_px: fx, fy, cx, cy of the depth camera.
        depth_scale: counts per metre.
        pose_sigma_m: standard deviation of each coordinate of the camera's position.
        pose_sigma_rad: standard deviation of its rotation about each world axis.
        max_pose_gap_s: the longest time between two poses that interpolation bridges; a pose
            exactly at the stamp of a frame needs no neighbours.
        with_poses: whether `groundtruth.txt` is used.
        frames_without_pose: "refuse" to open when a frame has no pose, or "keep" such frames and
            give them without one (motion capture loses sight for up to 1 s in published files).
        name: the instance's name.
    """

    model = "TUM RGB-D folder"

    def __init__(
        self,
        folder: Path | str,
        *,
        intrinsics_px: Sequence[float],
        depth_scale: float = 5000.0,
        pose_sigma_m: float = POSE_SIGMA_M,
        pose_sigma_rad: float = POSE_SIGMA_RAD,
        max_pose_gap_s: float = MAX_POSE_GAP_S,
        with_poses: bool = True,
        frames_without_pose: FramesWithoutPose = "refuse",
        name: str = "depth",
    ) -> None:
        super().__init__(
            folder,
            intrinsics_px=intrinsics_px,
            counts_per_m=depth_scale,
            pose_settings=PoseSettings(
                sigma_m=pose_sigma_m,
                sigma_rad=pose_sigma_rad,
                max_gap_s=max_pose_gap_s,
                frames_without_pose=frames_without_pose,
            ),
            name=name,
        )
        self._with_poses = with_poses

    def find(self) -> Listing:
        """Read `depth.txt` and, where it exists, `accelerometer.txt`."""
        index = self.folder / "depth.txt"
        images = []
        for sequence, row in enumerate(read_rows(index, "stamp filename")):
            path = self.folder / row.rest
            if not row.rest or not path.is_file():
                raise DriverError(
                    f"{index}:{row.line}: image {row.rest!r} is not there; expected a file in "
                    f"{self.folder}, restore it or drop the line"
                )
            images.append(DepthImage(path, row.t_ns, sequence))
        trajectory = self.folder / "groundtruth.txt"
        if self._with_poses and not trajectory.is_file():
            raise DriverError(
                f"{trajectory} is not there; expected the camera's poses, restore it or "
                "import without poses (with_poses=False, --no-poses)"
            )
        return Listing(images, trajectory if self._with_poses else None, self._accelerations())

    def _accelerations(self) -> list[AccelerationSample]:
        path = self.folder / "accelerometer.txt"
        if not path.exists():
            return []
        rows, values = read_table(path, "stamp ax ay az")
        return [
            AccelerationSample(row.t_ns, frozen_array(vector, (3,)), sequence)
            for sequence, (row, vector) in enumerate(zip(rows, values, strict=True))
        ]


class MillimetrePngFolder(DepthFolder):
    """A folder of 16-bit PNGs in millimetres whose names say when they were taken.

    The name without `.png` is decimal seconds (`1341841278.842700`), nanoseconds (16 digits or
    more), or a frame number, which is at number / `rate_hz` seconds.

    Args:
        folder: the folder; files that do not end in `.png` are ignored.
        intrinsics_px: fx, fy, cx, cy of the depth camera.
        poses: a trajectory file of `stamp tx ty tz qx qy qz qw` lines, or None.
        rate_hz: frames per second; needed for frame numbers and only for them.
        pose_sigma_m: as in `TumFolder`, like the next three.
        pose_sigma_rad: as in `TumFolder`.
        max_pose_gap_s: as in `TumFolder`.
        frames_without_pose: as in `TumFolder`.
        name: the instance's name.
    """

    model = "millimetre PNG folder"

    def __init__(
        self,
        folder: Path | str,
        *,
        intrinsics_px: Sequence[float],
        poses: Path | str | None = None,
        rate_hz: float | None = None,
        pose_sigma_m: float = POSE_SIGMA_M,
        pose_sigma_rad: float = POSE_SIGMA_RAD,
        max_pose_gap_s: float = MAX_POSE_GAP_S,
        frames_without_pose: FramesWithoutPose = "refuse",
        name: str = "depth",
    ) -> None:
        super().__init__(
            folder,
            intrinsics_px=intrinsics_px,
            counts_per_m=1000.0,
            pose_settings=PoseSettings(
                sigma_m=pose_sigma_m,
                sigma_rad=pose_sigma_rad,
                max_gap_s=max_pose_gap_s,
                frames_without_pose=frames_without_pose,
            ),
            name=name,
        )
        self._trajectory = None if poses is None else Path(poses)
        self._rate_hz = rate_hz

    def find(self) -> Listing:
        """List the PNGs in the order of the times that their names say."""
        paths = [path for path in self.folder.iterdir() if path.suffix.lower() == ".png"]
        if not paths:
            raise DriverError(f"{self.folder} has no .png files; expected depth images in it")
        timed = sorted(zip(_stamps_ns(paths, self._rate_hz), paths, strict=True))
        for (t_ns, path), (next_t_ns, next_path) in itertools.pairwise(timed):
            if t_ns == next_t_ns:
                raise DriverError(
                    f"{path.name} and {next_path.name} in {self.folder} have the same stamp; "
                    "expected one image per stamp, drop one of the two"
                )
        return Listing(_numbered(timed, self._rate_hz), self._trajectory)


def _stamps_ns(paths: Sequence[Path], rate_hz: float | None) -> list[int]:
    """Return the times that the names say; frame numbers if and only if there is a rate."""
    if rate_hz is not None:
        check_positive("rate_hz", rate_hz)
    stamps_ns = []
    for path in paths:
        is_number = _FRAME_NUMBER.fullmatch(path.stem) is not None
        if is_number and rate_hz is None:
            raise DriverError(
                f"{path} is named by frame number; set rate_hz (--rate-hz) to give it a time"
            )
        if not is_number and rate_hz is not None:
            raise DriverError(
                f"{path} is not named by frame number but rate_hz is set; expected digits, or "
                "leave out rate_hz if the names are stamps"
            )
        stamps_ns.append(_stamp_ns(path, rate_hz))
    return stamps_ns


def _stamp_ns(path: Path, rate_hz: float | None) -> int:
    if rate_hz is not None:
        return round(int(path.stem) * 1e9 / rate_hz)
    if _NANOSECONDS.fullmatch(path.stem):
        return int(path.stem)
    try:
        return parse_stamp_ns(path.stem)
    except ValueError as error:
        raise DriverError(
            f"{path}: {error}; expected a name in seconds (1341841278.842700.png), nanoseconds "
            "or frame number, rename it or move it out of the folder"
        ) from error


def _numbered(timed: Sequence[tuple[int, Path]], rate_hz: float | None) -> list[DepthImage]:
    """Number the images: by their order, or by frame number so that a gap shows lost frames."""
    if rate_hz is None:
        return [DepthImage(path, t_ns, index) for index, (t_ns, path) in enumerate(timed)]
    first = int(timed[0][1].stem)
    return [DepthImage(path, t_ns, int(path.stem) - first) for t_ns, path in timed]
