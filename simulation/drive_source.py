"""Poses and depth along a simulated drive, as a source."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.errors import DriverError, EndOfSource
from drivers.samples import DepthFrame, PoseSample, Sample, frozen_array
from drivers.source import SourceInfo
from simulation.motion import START_NS

Float64Array = NDArray[np.float64]

FRAME_PERIOD_NS = 100_000_000
_POSES_PER_FRAME = 5


class DriveSource(ABC):
    """Source of exact poses (50 Hz) and depth (10 Hz).

    Args:
        name: the instance's name.
        model: what kind of simulated camera it is.
        frames: number of depth frames; the first is at the start.
        details: what the drive is made of, as text.
    """

    def __init__(self, name: str, model: str, frames: int, details: Mapping[str, str]) -> None:
        self.name = name
        self.frames = frames
        self._model = model
        self._details = details
        self._next: int | None = None
        self._given = 0

    @abstractmethod
    def body_pose(self, t_ns: int) -> tuple[Float64Array, Float64Array]:
        """Return position (3,) and rotation (3, 3) of the tracked body, t_ns after the start."""

    @abstractmethod
    def depth_frame(self, index: int, t_ns: int) -> DepthFrame:
        """Return the frame of that number, t_ns after the start, stamped START_NS + t_ns."""

    def open(self) -> SourceInfo:
        """Start at the beginning of the drive."""
        self._next = self._given = 0
        return SourceInfo(
            name=self.name,
            model=self._model,
            serial="",
            produces=(PoseSample, DepthFrame),
            time_base="recorded",
            details={**self._details, "frames": str(self.frames)},
            nominal_rate_hz={PoseSample: 50.0, DepthFrame: 10.0},
        )

    def read(self, timeout_s: float) -> Sequence[Sample]:  # noqa: ARG002 - never waits
        """Return the poses up to the next depth frame, and that frame.

        Raises:
            DriverError: not open.
            EndOfSource: the drive is over.
        """
        if self._next is None:
            raise DriverError(f"{self.name}: read before open")
        if self._next >= self.frames:
            raise EndOfSource(f"{self.name}: end of the drive")
        index = self._next
        first = index * _POSES_PER_FRAME - (_POSES_PER_FRAME - 1 if index else 0)
        poses = [self._pose(i) for i in range(first, index * _POSES_PER_FRAME + 1)]
        frame = self.depth_frame(index, index * FRAME_PERIOD_NS)
        self._next = self._given = index + 1
        return [*poses, frame]

    def close(self) -> None:
        """Forget where the drive was; harmless when closed."""
        self._next = None

    @property
    def frames_given(self) -> int:
        """Return how many frames were read since the drive was opened last."""
        return self._given

    def _pose(self, index: int) -> PoseSample:
        t_ns = index * FRAME_PERIOD_NS // _POSES_PER_FRAME
        position, rotation = self.body_pose(t_ns)
        quat = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
        return PoseSample(
            START_NS + t_ns,
            frozen_array(position, (3,)),
            frozen_array(quat, (4,)),
            frozen_array(np.zeros((6, 6)), (6, 6)),
            index,
        )
