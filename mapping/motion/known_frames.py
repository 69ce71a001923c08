"""Which depth frames the runs before have dealt with, so that none is counted twice.

A frame is known by its stamp and its pixels, wherever it comes from: the recording that a crash
broke off, a piece cut out of it, or one that it was merged into.
"""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from drivers.samples import DepthFrame
from mapping.errors import MappingError
from mapping.mapper_counts import MapperCounts

# (frames, 2): stamp in ns, and the CRC-32 of some of the image's rows.
Keys = NDArray[np.int64]

_FIRST_ROWS = 1024
# A sensor's noise makes any of its rows its own; an eighth of them takes 0.02 ms.
_ROW_STEP = 8


class KnownFrames:
    """Tells the frames of the runs before from new ones, and notes those.

    Args:
        before: keys of the frames of the runs before; None = nobody keeps them, and none is known.
        counts: where known frames are counted.
        pose_source: of the settings; recorded poses alone suit the rest of a recording too.
    """

    def __init__(self, before: Keys | None, counts: MapperCounts, pose_source: str) -> None:
        self._is_kept = before is not None
        self._counts = counts
        self._resumable = pose_source.startswith("mocap")
        known = no_keys() if before is None else before
        self._now = len(known)
        self._keys = np.concatenate([known, np.zeros((_FIRST_ROWS, 2), np.int64)])
        self._before = known[np.argsort(known[:, 0], kind="stable")]

    @property
    def keys(self) -> Keys | None:
        """Those of all frames so far, a view; None where nobody keeps them."""
        return self._keys[: self._now] if self._is_kept else None

    def is_new(self, frame: DepthFrame) -> bool:
        """Tell whether no run before had this frame; one that had is counted.

        Raises:
            MappingError: one had, and poses that go on from there do not suit this recording.
        """
        stamps = self._before[:, 0]
        first = np.searchsorted(stamps, frame.t_ns, "left")
        last = np.searchsorted(stamps, frame.t_ns, "right")
        if first == last or _checksum(frame) not in self._before[first:last, 1]:
            return True
        if not self._resumable:
            raise MappingError(
                f"the world holds the depth frame at {frame.t_ns} ns already, and poses of "
                "ego-motion go on where the world's last run ended, not within a recording; give "
                "the recording that follows, or map this one into a new world"
            )
        self._counts.frames_known += 1
        return False

    def add(self, frame: DepthFrame) -> None:
        """Note a frame that was dealt with: mapped, or found to fit nowhere."""
        if not self._is_kept:
            return
        if self._now == len(self._keys):
            self._keys = np.concatenate([self._keys, np.zeros_like(self._keys)])
        self._keys[self._now] = frame.t_ns, _checksum(frame)
        self._now += 1


def no_keys() -> Keys:
    """Return the keys of no frame."""
    return np.zeros((0, 2), np.int64)


def _checksum(frame: DepthFrame) -> int:
    return zlib.crc32(frame.depth_mm[::_ROW_STEP].tobytes())
