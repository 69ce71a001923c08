"""Checks of settings that several drivers share."""

from __future__ import annotations

import math
from collections.abc import Sequence

from drivers.errors import DriverError


def check_positive(setting: str, value: float) -> None:
    """Raise DriverError unless the value of that setting is a finite number above zero."""
    if not (math.isfinite(value) and value > 0):
        raise DriverError(f"{setting} is {value}; expected a finite number above 0, set it")


def check_not_negative(setting: str, value: float) -> None:
    """Raise DriverError unless the value of that setting is a finite number, zero or more."""
    if not (math.isfinite(value) and value >= 0):
        raise DriverError(f"{setting} is {value}; expected a finite number of 0 or more, set it")


def check_intrinsics(intrinsics_px: Sequence[float]) -> None:
    """Raise DriverError unless these can be fx, fy, cx, cy of a camera."""
    if len(intrinsics_px) != 4 or not all(map(math.isfinite, intrinsics_px)):
        raise DriverError(
            f"intrinsics_px is {intrinsics_px}; expected four finite numbers fx, fy, cx, cy"
        )
    check_positive("fx of intrinsics_px", intrinsics_px[0])
    check_positive("fy of intrinsics_px", intrinsics_px[1])
