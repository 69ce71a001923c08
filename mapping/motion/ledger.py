"""All motions of a run as sums, so that a cell learns of them when it is looked at, not before.

A motion moves a cell relative to the rover by dr + (e x r) d_yaw, r = cell - rover. Referred to a
fixed point of T, the anchor, instead of to the rover, the error of a motion is one (x, y, yaw) for
all cells, and the errors of motions that follow each other add up. A cell that was last seen when
the sum was S' has gained J (S - S') J' with J = [1, 0, -p_y; 0, 1, p_x], p = cell - anchor. That
is exact, takes O(1) for every motion, and no sweep over the map.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapping.errors import MappingError
from mapping.motion.relative import RelativeMotion, clip_to_psd, to_terrain_axes

Float64Array = NDArray[np.float64]

# Columns of the sums: covariance of (x, y, yaw) about the anchor, variance of z, way driven.
SUM_XX, SUM_XY, SUM_YY, SUM_XYAW, SUM_YYAW, SUM_YAW, SUM_ZZ, SUM_M = range(8)

_FIRST_ROWS = 1024


class Motions(NamedTuple):
    """All motions so far.

    sums: (rows, 8); row n = sums over the motions up to the n-th, row 0 = zeros. `now`: row that
    is valid now; `anchor_x_m`, `anchor_y_m`: the anchor in T.
    """

    sums: Float64Array
    now: int
    anchor_x_m: float
    anchor_y_m: float


def at_rest() -> Motions:
    """Return the sums of a rover that has not moved, or whose poses are absolute."""
    return MotionLedger(with_covariance=False).motions


class MotionLedger:
    """Adds up motions. Its rows are kept for the run: 64 bytes for every motion."""

    def __init__(self, *, with_covariance: bool, before: Motions | None = None) -> None:
        """Start at rest, or with the motions of the runs before.

        `with_covariance`: as in `PoseErrorModel.motion_covariance`.
        """
        self._with_covariance = with_covariance
        self._sums = np.zeros((_FIRST_ROWS, 8))
        self._now = 0
        self._anchor: tuple[float, float] | None = None
        self.clipped = 0
        if before is not None and before.now > 0:
            self._sums = np.concatenate([before.sums[: before.now + 1], self._sums])
            self._now = before.now
            self._anchor = before.anchor_x_m, before.anchor_y_m

    @property
    def motions(self) -> Motions:
        """The sums as they are now; a view, valid until the next motion."""
        x, y = self._anchor or (0.0, 0.0)
        return Motions(self._sums, self._now, x, y)

    def add(self, motion: RelativeMotion) -> None:
        """Take the next motion; a negative eigenvalue of its covariance is clipped and counted.

        Raises:
            MappingError: a number is not finite, or the way is negative.
        """
        _check(motion)
        x, y = float(motion.position_m[0]), float(motion.position_m[1])
        anchor_x, anchor_y = self._anchor or (x, y)
        # A motion comes with every frame: numbers this few are sooner handled one by one.
        sums = [0.0] * 7
        if self._with_covariance:
            covariance, was_clipped = clip_to_psd(motion.covariance)
            self.clipped += was_clipped
            to_anchor = to_terrain_axes(motion.yaw_rad)
            to_anchor[:2, 3] = y - anchor_y, anchor_x - x
            (xx, xy, _, x_yaw), (_, yy, _, y_yaw), (_, _, zz, _), (_, _, _, yaw) = (
                to_anchor @ covariance @ to_anchor.T
            ).tolist()
            sums = [xx, xy, yy, x_yaw, y_yaw, yaw, zz]
        sums.append(motion.distance_m)
        if any(sums):
            self._anchor = anchor_x, anchor_y
            self._append(self._sums[self._now] + sums)

    def _append(self, row: Float64Array) -> None:
        if self._now + 1 == self._sums.shape[0]:
            self._sums = np.concatenate([self._sums, np.zeros_like(self._sums)])
        self._now += 1
        self._sums[self._now] = row


def _check(motion: RelativeMotion) -> None:
    # A sum is finite only where all of its terms are.
    total = sum(motion.covariance.ravel().tolist()) + sum(motion.position_m.tolist())
    total += motion.yaw_rad
    if not (math.isfinite(total) and 0.0 <= motion.distance_m < math.inf):
        raise MappingError(
            f"motion that ends at {motion.t_ns} ns has a number that is not finite, or a negative "
            "way; expected metres, radians and a covariance"
        )
