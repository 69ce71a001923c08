"""Whether the wheels grip: their yaw rate against that of the gyro.

Wheels that turn the rover otherwise than it turns have lost the ground on one side at least, and
what they say of the speed is then no better: v may be anything from 0 to what they say. Wheels
that spin alike on both sides contradict nothing.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from mapping.ego_motion.blocks import Blocks
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.geometry import Float64Array

_HALF_S = 0.1
# From so many sigmas of disagreement on the wheels are doubted, and at so many they are lost.
_DOUBT, _LOSS = 2.0, 4.0


def slip_variance(blocks: Blocks, settings: EgoMotionSettings) -> tuple[Float64Array, Float64Array]:
    """Return the (N,) variance of the slip at blocks, and how doubtful the wheels are (0 to 1)."""
    known = (blocks.wheels_ok & blocks.gyro_ok).astype(np.float64)
    width = 2 * round(_HALF_S / settings.tick_s) + 1

    def mean(values: Float64Array) -> Float64Array:
        """Return the (N,) running mean of values over the blocks where both are known."""
        share = uniform_filter1d(known, width)
        total = uniform_filter1d(known * values, width)
        return np.asarray(total / np.maximum(share, 1.0 / width), np.float64)

    apart = np.abs(mean(blocks.wheel_turn_rad_s - blocks.turn_rad_s))
    sigma = np.sqrt(
        mean(blocks.wheel_turn_sigma_rad_s) ** 2
        + (settings.track_sigma * mean(blocks.wheel_turn_rad_s)) ** 2
        + settings.gyro_bias_rad_s**2
    )
    ratio = np.divide(apart, sigma, out=np.zeros_like(apart), where=known > 0.0)
    doubt = np.clip((ratio - _DOUBT) / (_LOSS - _DOUBT), 0.0, 1.0)
    return settings.slip**2 + (settings.slip_lost * doubt) ** 2, doubt
