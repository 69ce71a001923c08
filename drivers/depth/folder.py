"""A folder of 16-bit depth images played as a source; the layouts are in depth_files.

Everything that can be checked without decoding pixels is checked by `open`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from drivers.checks import check_intrinsics, check_positive
from drivers.depth.png import MillimetreTable, check_headers, read_counts
from drivers.depth.trajectory import interpolate, read_trajectory
from drivers.errors import DriverError, EndOfSource
from drivers.faults import NO_FAULTS, Faults
from drivers.samples import (
    AccelerationSample,
    CameraIntrinsics,
    DepthFrame,
    PoseSample,
    Sample,
    frozen_array,
)
from drivers.source import SourceInfo

# Sturm et al. 2012 state that the error of their motion capture stays below about 10 mm and
# 0.5 deg. Taken as a 2-sigma bound: on a floor 2 m away 5 mm and 0.25 deg make 10 mm of height,
# and the floor of the fr3/cabinet frames was measured to move by 8 mm (1 sigma) between frames.
POSE_SIGMA_M = 0.005
POSE_SIGMA_RAD = math.radians(0.25)

# Ten periods of 100 Hz motion capture, three frames of depth.
MAX_POSE_GAP_S = 0.1

FramesWithoutPose = Literal["refuse", "keep"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSettings:
    """How poses are taken from a trajectory.

    Attributes:
        sigma_m: standard deviation of each position coordinate.
        sigma_rad: standard deviation of the rotation about each world axis.
        max_gap_s: the longest time between two poses that interpolation bridges.
        frames_without_pose: "refuse" to open when a frame has no pose, or "keep" such frames and
            give them without one.
    """

    sigma_m: float
    sigma_rad: float
    max_gap_s: float
    frames_without_pose: FramesWithoutPose

    def check(self) -> None:
        """Raise DriverError unless the settings make sense."""
        check_positive("pose_sigma_m", self.sigma_m)
        check_positive("pose_sigma_rad", self.sigma_rad)
        check_positive("max_pose_gap_s", self.max_gap_s)
        if self.frames_without_pose not in ("refuse", "keep"):
            raise DriverError(
                f"frames_without_pose is {self.frames_without_pose!r}; expected 'refuse' or 'keep'"
            )


@dataclass(frozen=True, slots=True)
class DepthImage:
    """One image file of a folder, with its time and its number in the sequence."""

    path: Path
    t_ns: int
    sequence: int


@dataclass(frozen=True, slots=True)
class Listing:
    """What a layout found in its folder: images in time order, and what goes with them."""

    images: Sequence[DepthImage]
    trajectory: Path | None
    accelerations: Sequence[AccelerationSample] = ()


@dataclass(frozen=True, slots=True)
class _Contents:
    """A checked folder: what it lists, and all that is needed to turn that into samples."""

    listing: Listing
    poses: Sequence[PoseSample | None]
    camera: CameraIntrinsics
    table: MillimetreTable

    def batches(self) -> Iterator[Sequence[DepthImage | Sample]]:
        """Yield, per image, what is due up to it; what follows the last image comes last."""
        accelerations = self.listing.accelerations
        start = 0
        for image, pose in zip(self.listing.images, self.poses, strict=True):
            stop = start
            while stop < len(accelerations) and accelerations[stop].t_ns <= image.t_ns:
                stop += 1
            yield [*accelerations[start:stop], *([] if pose is None else [pose]), image]
            start = stop
        if start < len(accelerations):
            yield accelerations[start:]

    def load(self, image: DepthImage) -> DepthFrame:
        """Decode an image."""
        counts = read_counts(image.path, (self.camera.width_px, self.camera.height_px))
        depth_mm = self.table.convert(counts, image.path)
        return DepthFrame(image.t_ns, depth_mm, self.camera, image.sequence)


class DepthFolder(ABC):
    """Opens, reads and closes a folder; a layout says how its images are found.

    Args:
        folder: where the images are.
        intrinsics_px: fx, fy, cx, cy of the depth camera, in pixels of these images.
        counts_per_m: scale of the images.
        pose_settings: how poses are taken from the trajectory.
        name: the instance's name.
    """

    model: str

    def __init__(
        self,
        folder: Path | str,
        *,
        intrinsics_px: Sequence[float],
        counts_per_m: float,
        pose_settings: PoseSettings,
        name: str,
    ) -> None:
        self.folder = Path(folder)
        self._intrinsics_px = tuple(intrinsics_px)
        self._counts_per_m = counts_per_m
        self._pose_settings = pose_settings
        self._name = name
        self._contents: _Contents | None = None
        self._batches: Iterator[Sequence[DepthImage | Sample]] = iter(())

    @property
    def name(self) -> str:
        """The instance's name."""
        return self._name

    @abstractmethod
    def find(self) -> Listing:
        """List the images and what goes with them, decoding nothing.

        Raises:
            DriverError: the folder does not have this layout.
        """

    @property
    def faults(self) -> Faults:
        """None: a file that cannot be read is an error."""
        return NO_FAULTS

    def open(self) -> SourceInfo:
        """Check settings, texts and image headers.

        Raises:
            DriverError: anything that would stop the folder from being played to its end, apart
                from damaged pixels.
        """
        self.close()
        try:
            contents = self._check()
        except DriverError as error:
            raise DriverError(f"{self._name}: {error}") from error
        except OSError as error:  # pathlib tells a missing file from a forbidden one by raising
            raise DriverError(
                f"{self._name}: cannot look into {self.folder}: {error}; expected a folder that "
                "this user may read, check its permissions"
            ) from error
        self._contents = contents
        self._batches = contents.batches()
        return self._describe(contents)

    def read(self, timeout_s: float) -> Sequence[Sample]:  # noqa: ARG002 - files do not wait
        """Return the next depth frame, before it its pose and the accelerations up to it.

        Raises:
            DriverError: not open, or the image is damaged; the next call goes on behind it.
            EndOfSource: everything was given.
        """
        if self._contents is None:
            raise DriverError(f"{self._name} is not open; call open() before read()")
        batch = next(self._batches, None)
        if batch is None:
            raise EndOfSource(f"{self._name}: end of {self.folder}")
        try:
            return [
                self._contents.load(item) if isinstance(item, DepthImage) else item
                for item in batch
            ]
        except DriverError as error:
            raise DriverError(f"{self._name}: {error}") from error

    def close(self) -> None:
        """Forget the folder; no file stays open between reads."""
        self._contents = None
        self._batches = iter(())

    def _check(self) -> _Contents:
        check_positive("depth_scale", self._counts_per_m)
        check_intrinsics(self._intrinsics_px)
        self._pose_settings.check()
        if not self.folder.is_dir():
            raise DriverError(f"{self.folder} is not a folder; expected one with depth images")
        listing = self.find()
        poses = _find_poses(listing, self._pose_settings)
        width_px, height_px = check_headers([image.path for image in listing.images])
        camera = CameraIntrinsics(width_px, height_px, *self._intrinsics_px)
        return _Contents(listing, poses, camera, MillimetreTable(self._counts_per_m))

    def _describe(self, contents: _Contents) -> SourceInfo:
        times_ns: dict[type[Sample], list[int]] = {
            DepthFrame: [image.t_ns for image in contents.listing.images],
            PoseSample: [pose.t_ns for pose in contents.poses if pose is not None],
            AccelerationSample: [sample.t_ns for sample in contents.listing.accelerations],
        }
        return SourceInfo(
            name=self._name,
            model=self.model,
            serial="",
            produces=tuple(kind for kind, times in times_ns.items() if times),
            time_base="recorded",
            details={
                "folder": self.folder.resolve().name,
                **{kind.__name__: str(len(times)) for kind, times in times_ns.items()},
                "counts_per_m": f"{self._counts_per_m:g}",
                "size_px": f"{contents.camera.width_px}x{contents.camera.height_px}",
                "fx_fy_cx_cy_px": " ".join(f"{value:g}" for value in self._intrinsics_px),
            },
            nominal_rate_hz={
                kind: 1e9 * (len(times) - 1) / (times[-1] - times[0])
                for kind, times in times_ns.items()
                if len(times) > 1
            },
        )


def _find_poses(listing: Listing, settings: PoseSettings) -> list[PoseSample | None]:
    """Return the pose of each image, None where there is none and that is allowed."""
    if listing.trajectory is None:
        return [None] * len(listing.images)
    trajectory = read_trajectory(listing.trajectory)
    t_ns = np.array([image.t_ns for image in listing.images], dtype=np.int64)
    position_m, quat_wxyz, known = interpolate(trajectory, t_ns, settings.max_gap_s)
    missing = np.flatnonzero(~known)
    if missing.size and (settings.frames_without_pose == "refuse" or not known.any()):
        raise DriverError(
            f"{listing.trajectory} has no pose for {missing.size} of {len(t_ns)} frames, the first "
            f"at {t_ns[missing[0]] / 1e9:.6f} s and the last at {t_ns[missing[-1]] / 1e9:.6f} s; "
            f"expected poses at or around each with gaps up to {settings.max_gap_s:g} s, "
            "set max_pose_gap_s, or frames_without_pose='keep' if only some lack one"
        )
    variance = [settings.sigma_m**2] * 3 + [settings.sigma_rad**2] * 3
    covariance = frozen_array(np.diag(variance), (6, 6))
    return [
        PoseSample(
            image.t_ns,
            frozen_array(position_m[index], (3,)),
            frozen_array(quat_wxyz[index], (4,)),
            covariance,
            image.sequence,
        )
        if known[index]
        else None
        for index, image in enumerate(listing.images)
    ]
