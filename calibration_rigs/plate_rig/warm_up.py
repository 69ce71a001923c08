"""Whether the camera has warmed up: its readings of a plate that stands still stand still too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration_rigs.plate_rig.frames import CellFrames

READINGS_AT_LEAST = 8
_LONG_ENOUGH_S = 600.0
_LAST_S = 900.0
_SHARE_OF_STEP = 0.1


@dataclass(frozen=True, slots=True)
class WarmUp:
    """The verdict.

    Attributes:
        is_warm: the drift is below a tenth of a step in ten minutes, and known that well.
        drift_m: in ten minutes. drift_sigma_m: its standard deviation.
        text: the same in words.
    """

    is_warm: bool
    drift_m: float
    drift_sigma_m: float
    text: str


def judge_warm_up(times_s: list[float], z_m: list[float], step_m: float) -> WarmUp:
    """Return the slope of mean distances over the last quarter of an hour.

    Args:
        times_s, z_m: when, and the mean distance of the plate's middle.
        step_m: depth step of the sensor there.
    """
    times = np.array(times_s)
    recent = times >= (times[-1] - _LAST_S if times.size else 0.0)
    t, z = times[recent], np.array(z_m)[recent]
    if t.size < READINGS_AT_LEAST or np.ptp(t) < _LONG_ENOUGH_S:
        missing_s = _LONG_ENOUGH_S - (float(np.ptp(t)) if t.size else 0.0)
        text = f"too short to tell, about {max(missing_s, 60.0) / 60.0:.0f} min to go"
        return WarmUp(False, 0.0, float("inf"), text)
    columns = np.column_stack([np.ones_like(t), t - t.mean()])
    fit, *_ = np.linalg.lstsq(columns, z, rcond=None)
    left = z - columns @ fit
    slope_sigma = np.sqrt(left @ left / (t.size - 2) / np.sum((t - t.mean()) ** 2))
    drift, sigma = float(fit[1] * _LONG_ENOUGH_S), float(slope_sigma * _LONG_ENOUGH_S)
    limit = _SHARE_OF_STEP * step_m
    is_warm = abs(drift) < limit and sigma < limit
    verdict = "below" if is_warm else "not below"
    found = f"{1e3 * drift:+.2f} ± {1e3 * sigma:.2f} mm in 10 min"
    text = f"{found}, {verdict} {1e3 * limit:.2f} mm"
    return WarmUp(is_warm, drift, sigma, text)


def middle_z_m(frames: CellFrames) -> float:
    """Return the mean reading of the middle third of the image; NaN without readings."""
    height, width = frames.depth_mm.shape[1:]
    box: NDArray[np.uint16] = frames.depth_mm[
        :, height // 3 : height - height // 3, width // 3 : width - width // 3
    ]
    there = box[box > 0]
    return 1e-3 * float(there.mean()) if there.size else float("nan")
