"""One cell and hand-made measurements of it, fed through the fusion kernel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapping.cells.cell_layers import empty_layers
from mapping.cells.update_constants import FrameConstants, fusion_constants
from mapping.cells.update_kernels import fuse
from mapping.cells.update_types import UpdateCounts
from mapping.motion.ledger import Motions, at_rest
from mapping.settings import MapSettings

Float64Array = NDArray[np.float64]
SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class Seen:
    """What a frame says of a cell.

    own_m2: variance of the mean. common_m2: from the pose. systematic: height change for one sigma
    of the mount's three angles and the bias. offsets_m: pixels around the mean, of equal weight;
    with n of them each has the variance n * own_m2.
    """

    height_m: float
    own_m2: float
    common_m2: float = 0.0
    systematic: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    offsets_m: Sequence[float] = (0.0,)
    t_ns: int = 0


def constants(**changes: Any) -> FrameConstants:
    """Return the geometry of a cell 1 m in front of a camera at height 0, without any error."""
    names = FrameConstants._fields
    values: dict[str, Any] = dict.fromkeys(names, 0.0)
    values |= {"t_ns": 0, "first_column": 0, "first_row": 0, "cells_x": 1, "cells_y": 1}
    # The middle of the cell is at x = 0, y = 1 m from the camera, whose axis is y.
    values |= {"cell_size_m": 0.04, "corner_x_m": -0.02, "corner_y_m": 0.98, "r12": 1.0}
    values |= {"correlation_area_px": 1.0, "range_min_m": 0.1}
    return FrameConstants(**(values | changes))


def sums_of(heights_m: Sequence[float], weight: float) -> Float64Array:
    """Return (1, 4) sums of pixels of equal weight."""
    h = np.asarray(heights_m, float)
    return np.array([[weight * h.size, weight * h.sum(), weight * (h * h).sum(), h.size]])


class Cell:
    """A map of one cell."""

    def __init__(self, **settings: Any) -> None:
        self.layers = empty_layers(1, 1)
        self._fusion = fusion_constants(
            MapSettings(**({"sigma_floor_m": 1e-6, "sigma_ceiling_m": 100.0} | settings))
        )

    def see(self, seen: Seen, motions: Motions | None = None, **changes: float) -> UpdateCounts:
        """Fuse one frame after these motions, with these constants changed.

        Its pixels lie 1 m above the camera: both ends are exact.
        """
        a, b, c, bias = seen.systematic
        n = len(seen.offsets_m)
        # dh = mount . (r00 y - r10 x, r01 y - r11 x, r02 y - r12 x) with x = 0, y = 1, and the
        # depth r02 x + r12 y + r22 h is 1.
        frame = constants(
            t_ns=seen.t_ns,
            camera_z_m=seen.height_m - 1.0,
            mount_rad=1.0,
            r00=a,
            r01=b,
            r02=c,
            bias_0_m=bias,
            pose_zz=seen.common_m2,
            **changes,
        )
        sums = sums_of([1.0 + offset for offset in seen.offsets_m], 1.0 / (n * seen.own_m2))
        counts = fuse(sums, frame, self._fusion, self.layers, motions or at_rest())
        assert not sums.any(), "the sums must be cleared for the next frame"
        return counts

    def __getattr__(self, name: str) -> Any:
        """Return a layer's number as Python has it."""
        return getattr(self.layers, name)[0, 0].item()

    @property
    def systematic(self) -> Float64Array:
        """(4,) sensitivities to mount a, b, c and bias."""
        names = ("systematic_a_m", "systematic_b_m", "systematic_c_m", "systematic_bias_m")
        return np.array([getattr(self, name) for name in names])

    @property
    def total_m2(self) -> float:
        """Variance of the height apart from relief."""
        return float(self.variance_m2 + self.systematic @ self.systematic)
