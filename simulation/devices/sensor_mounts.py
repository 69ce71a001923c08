"""Where the simulated devices sit on the rover, as plain data for a recording."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from drivers.samples import frozen_array
from simulation.devices.camera_mount import CameraMount
from simulation.vehicle import jackal
from simulation.vehicle.vehicle_run import DriveOptions

Float64Array = NDArray[np.float64]

_ROVER = "base_link"
_ORIGIN = (0.0, 0.0, 0.0)


class SensorMount(NamedTuple):
    """Pose of a child frame in a parent frame, under the recordings' names of frames.

    Attributes:
        parent_frame, child_frame: the names.
        position_m: (3,) origin of the child in the parent.
        quat_wxyz: (4,) unit quaternion, child axes to parent axes.
    """

    parent_frame: str
    child_frame: str
    position_m: Float64Array
    quat_wxyz: Float64Array


def sensor_mounts(options: DriveOptions, camera: CameraMount) -> tuple[SensorMount, ...]:
    """Return where everything sits; what is tracked is the rover's own frame."""
    sensor, gyro = options.accelerometer, options.gyro
    looking = Rotation.from_matrix(camera.rotation)
    turned = Rotation.from_rotvec(sensor.rotation_rad)
    return (
        _mount("mocap_body", _ROVER, _ORIGIN, Rotation.identity()),
        _mount(_ROVER, "depth_optical_frame", camera.position_m, looking),
        _mount(_ROVER, "accelerometer", sensor.position_m, turned),
        _mount(_ROVER, "vibration_sensor", sensor.position_m, turned),
        _mount(_ROVER, "gyro", _ORIGIN, Rotation.from_rotvec(gyro.rotation_rad)),
        _mount(_ROVER, "wheels", (0.0, 0.0, jackal.WHEEL_Z_M), Rotation.identity()),
    )


def _mount(parent: str, child: str, position_m: ArrayLike, rotation: Rotation) -> SensorMount:
    quat = rotation.as_quat(canonical=True, scalar_first=True)
    return SensorMount(parent, child, frozen_array(position_m, (3,)), frozen_array(quat, (4,)))
