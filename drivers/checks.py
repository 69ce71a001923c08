"""Checks of settings that several drivers share."""

from __future__ import annotations

import math
from collections.abc import Sequence

from drivers.errors import DriverError

# No setting in SI units comes near it, and its square and its nanoseconds can still be counted.
LARGEST = 1e9


def check_positive(setting: str, value: float) -> None:
    """Raise DriverError unless the value of that setting is a number above zero, to `LARGEST`."""
    if not 0.0 < value <= LARGEST:  # NaN too
        raise DriverError(f"{setting} is {value}; expected a number above 0, to {LARGEST:g}")


def check_not_negative(setting: str, value: float) -> None:
    """Raise DriverError unless the value of that setting is a number from zero to `LARGEST`."""
    if not 0.0 <= value <= LARGEST:
        raise DriverError(f"{setting} is {value}; expected a number of 0 or more, to {LARGEST:g}")


def check_intrinsics(intrinsics_px: Sequence[float]) -> None:
    """Raise DriverError unless these can be fx, fy, cx, cy of a camera."""
    if len(intrinsics_px) != 4 or not all(map(math.isfinite, intrinsics_px)):
        raise DriverError(
            f"intrinsics_px is {intrinsics_px}; expected four finite numbers fx, fy, cx, cy"
        )
    check_positive("fx of intrinsics_px", intrinsics_px[0])
    check_positive("fy of intrinsics_px", intrinsics_px[1])
