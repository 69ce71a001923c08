"""The fields that several ROS messages share: stamps, vectors, quaternions, and their checks.

Everything here raises ValueError with the reason alone; `messages` adds topic and time.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from rosbags.typesys.stores import ros2_humble as ros

from drivers.samples import Float64Array, frozen_array

NS_PER_S = 1_000_000_000
# builtin_interfaces/msg/Time counts whole seconds in an int32.
MAX_SECONDS = 2**31 - 1
MAX_UINT32 = 2**32 - 1
MAX_UINT64 = 2**64 - 1
_NO_NUMBER, _NO_INTEGER = (False, math.nan), (False, 0)

# Beyond _REFUSED a quaternion is no rotation; between the two it was rounded by whoever wrote
# it (a motion capture log with four decimals is off by up to 1e-4) and is normalised.
_ROUNDED = 1e-9
_REFUSED = 1e-3


def stamp_parts(t_ns: int) -> tuple[int, int]:
    """Return the seconds and nanoseconds of a stamp that is exactly `t_ns`."""
    seconds, nanoseconds = divmod(t_ns, NS_PER_S)
    if not 0 <= seconds <= MAX_SECONDS:
        raise ValueError(f"time {t_ns} ns does not fit a ROS stamp; expected 0 to 2^31 s")
    return seconds, nanoseconds


def ros_header(t_ns: int, frame_id: str) -> ros.std_msgs__msg__Header:
    """Return a header whose stamp is exactly `t_ns`."""
    return ros.std_msgs__msg__Header(
        ros.builtin_interfaces__msg__Time(*stamp_parts(t_ns)), frame_id
    )


def stamp_ns(header: ros.std_msgs__msg__Header) -> int:
    """Return the header's stamp in nanoseconds."""
    stamp = header.stamp
    if stamp.sec < 0 or stamp.nanosec >= NS_PER_S:
        raise ValueError(f"stamp of {stamp.sec} s and {stamp.nanosec} ns; expected 0 to 1e9-1 ns")
    return stamp.sec * NS_PER_S + stamp.nanosec


def finite(what: str, values: ArrayLike, shape: tuple[int, ...]) -> Float64Array:
    """Return the values as a read-only array of that shape, refusing NaN and infinity."""
    array = frozen_array(values, shape)
    if not np.isfinite(array).all():
        raise ValueError(f"{what} is not finite: {array.ravel().tolist()}")
    return array


def no_infinity(what: str, values: ArrayLike, shape: tuple[int, ...]) -> Float64Array:
    """Return the values as a read-only array of that shape; NaN stands for "no value"."""
    array = frozen_array(values, shape)
    if np.isinf(array).any():
        raise ValueError(f"{what} is infinite: {array.ravel().tolist()}")
    return array


def finite_number(what: str, value: float) -> float:
    """Return the value, refusing NaN and infinity."""
    if not math.isfinite(value):
        raise ValueError(f"{what} is not finite: {value}")
    return value


def integer(what: str, value: int, lowest: int, highest: int) -> int:
    """Return the value, refusing one outside the limits."""
    if not lowest <= value <= highest:
        raise ValueError(f"{what} is {value}; expected {lowest} to {highest}")
    return value


def flagged(what: str, value: float | None) -> tuple[bool, float]:
    """Return whether there is a value, and the value or NaN; the pair that `unflagged` takes."""
    return _NO_NUMBER if value is None else (True, _not_infinite(what, value))


def unflagged(what: str, is_there: bool, value: float) -> float | None:
    """Return the value, or None where the flag says that there is none; NaN is a value."""
    return _not_infinite(what, value) if is_there else None


def _not_infinite(what: str, value: float) -> float:
    if math.isinf(value):
        raise ValueError(f"{what} is infinite")
    return value


def flagged_integer(what: str, value: int | None, lowest: int, highest: int) -> tuple[bool, int]:
    """Return whether there is a value, and the value or 0."""
    return _NO_INTEGER if value is None else (True, integer(what, value, lowest, highest))


# The covariance by which an Imu message says that it does not measure this part: -1 in element 0.
# Source: sensor_msgs/msg/Imu.
NOT_MEASURED = (-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def require_measured(what: str, covariance: Float64Array) -> None:
    """Refuse the covariance of a part that was not measured."""
    if covariance[0] == -1.0:
        raise ValueError(f"the message says that {what} was not measured")


def vector(
    what: str, xyz: ros.geometry_msgs__msg__Vector3 | ros.geometry_msgs__msg__Point
) -> Float64Array:
    """Return x, y, z as a (3,) array."""
    return finite(what, (xyz.x, xyz.y, xyz.z), (3,))


def numbers(what: str, values: Float64Array, shape: tuple[int, ...]) -> list[float]:
    """Return the numbers of an array of that shape row by row, refusing NaN and infinity."""
    if values.shape == shape:
        found: list[float] = values.ravel().tolist()
        if math.isfinite(sum(found)):
            return found
    checked: list[float] = finite(what, values, shape).ravel().tolist()
    return checked


def three(what: str, values: Float64Array) -> list[float]:
    """Return the three numbers of a (3,) array, refusing NaN and infinity."""
    return numbers(what, values, (3,))


def three_or_nan(what: str, values: Float64Array) -> list[float]:
    """Return the three numbers of a (3,) array; NaN stands for "no value"."""
    numbers: list[float] = values.tolist()
    if values.shape != (3,) or math.inf in numbers or -math.inf in numbers:
        numbers = no_infinity(what, values, (3,)).tolist()
    return numbers


def ros_vector(what: str, values: Float64Array) -> ros.geometry_msgs__msg__Vector3:
    """Return a (3,) array as a Vector3."""
    return ros.geometry_msgs__msg__Vector3(*three(what, values))


def unit_quaternion(values: ArrayLike) -> Float64Array:
    """Return w, x, y, z as a (4,) unit quaternion; bit for bit where it is one already."""
    quat = finite("quaternion wxyz", values, (4,))
    # hypot, because squares of absurd but finite numbers overflow.
    norm = math.hypot(*quat.tolist())
    if abs(norm - 1.0) > _REFUSED:
        raise ValueError(f"quaternion wxyz {quat.tolist()} has length {norm:.6g}; expected 1")
    if abs(norm - 1.0) > _ROUNDED:
        quat = frozen_array(quat / norm, (4,))
    return quat


def xyzw(quat_wxyz: Float64Array) -> tuple[float, float, float, float]:
    """Return w, x, y, z as a ROS quaternion has them, which puts w last."""
    w, x, y, z = numbers("quaternion wxyz", quat_wxyz, (4,))
    if abs(math.hypot(w, x, y, z) - 1.0) > _ROUNDED:
        w, x, y, z = unit_quaternion(quat_wxyz).tolist()
    return x, y, z, w


def quaternion(rotation: ros.geometry_msgs__msg__Quaternion) -> Float64Array:
    """Return a ROS quaternion as w, x, y, z."""
    return unit_quaternion((rotation.w, rotation.x, rotation.y, rotation.z))
