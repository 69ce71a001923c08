"""Depth frames as sensor_msgs/msg/Image and CameraInfo; reasons of failure as ValueError."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.stores import ros2_humble as ros

from acquisition.messages import ros_fields as fields
from acquisition.messages.cdr_layout import Parts, layout, restamped
from acquisition.messages.companions import Companion
from acquisition.messages.frames import DEPTH_OPTICAL_FRAME
from acquisition.messages.ros_types import RosMessage, typestore
from drivers.samples import CameraIntrinsics, DepthFrame

DEPTH_ENCODING = "16UC1"
IMAGE_TYPE = "sensor_msgs/msg/Image"
CAMERA_TYPE = "sensor_msgs/msg/CameraInfo"
TICKS_TYPE = "terravibe_msgs/msg/DeviceTicks"


@dataclass(frozen=True, slots=True)
class DepthImage:
    """A depth frame that still lacks its camera, which is a message of its own.

    Attributes:
        t_ns: time of the frame.
        depth_mm: (height, width) uint16, read-only view of the message; 0 = no return.
        sequence: frame counter of the source.
    """

    t_ns: int
    depth_mm: NDArray[np.uint16]
    sequence: int


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """The intrinsics that hold for the depth image of the same time, and until the next ones."""

    t_ns: int
    camera: CameraIntrinsics


def depth_pixels(frame: DepthFrame) -> NDArray[np.uint16]:
    """Return the pixels, row by row, little-endian; the frame's own memory where possible."""
    height, width = frame.depth_mm.shape
    if frame.depth_mm.dtype != np.uint16:
        raise ValueError(f"depth has dtype {frame.depth_mm.dtype}; expected uint16")
    if (width, height) != (frame.camera.width_px, frame.camera.height_px):
        raise ValueError(
            f"depth is {width}x{height} px but its camera "
            f"{frame.camera.width_px}x{frame.camera.height_px} px"
        )
    return np.ascontiguousarray(frame.depth_mm, dtype="<u2").reshape(-1)


def encode_depth(frame: DepthFrame, t_ns: int, _sequence: int) -> Parts:
    """Return the image; its pixels are the frame's own memory, unless that may change."""
    height, width = frame.depth_mm.shape
    pixels = depth_pixels(frame).view(np.uint8)
    if pixels.flags.writeable:
        pixels = pixels.copy()
    return restamped(_image_head(height, width), t_ns), pixels.data


@lru_cache(maxsize=16)
def _image_head(height: int, width: int) -> bytes:
    """Return everything of an image but its pixels, which are the message's last bytes."""
    pixels = np.zeros(2 * height * width, dtype=np.uint8)
    image = ros.sensor_msgs__msg__Image(
        fields.ros_header(0, DEPTH_OPTICAL_FRAME),
        height,
        width,
        DEPTH_ENCODING,
        is_bigendian=0,
        step=2 * width,
        data=pixels,
    )
    return bytes(typestore().serialize_cdr(image, IMAGE_TYPE, little_endian=True)[: -pixels.size])


def decode_depth(image: ros.sensor_msgs__msg__Image, sequence: int) -> DepthImage:
    """Return the image as a view of the message's bytes."""
    size = f"{image.width}x{image.height} px"
    if image.encoding != DEPTH_ENCODING or image.is_bigendian:
        order = "big" if image.is_bigendian else "little"
        raise ValueError(
            f"image is {image.encoding!r} {order}-endian; expected {DEPTH_ENCODING} little-endian"
        )
    if image.width < 1 or image.height < 1 or image.step != 2 * image.width:
        raise ValueError(f"image of {size} has step {image.step}; expected 2 bytes per pixel")
    if image.data.size != image.step * image.height:
        raise ValueError(f"image of {size} has {image.data.size} bytes")
    depth_mm = image.data.view("<u2").reshape(image.height, image.width)
    depth_mm.flags.writeable = False
    return DepthImage(fields.stamp_ns(image.header), depth_mm, sequence)


def encode_ticks(frame: DepthFrame, t_ns: int, _sequence: int) -> Parts | None:
    """Return the device's own time of the frame, or None where it has none."""
    if frame.device_ticks is None:
        return None
    ticks = fields.integer("device ticks", frame.device_ticks, 0, fields.MAX_UINT64)
    return layout(TICKS_TYPE, DEPTH_OPTICAL_FRAME)(t_ns, ticks)


def decode_ticks(message: RosMessage, _sequence: int) -> Companion:
    """Return the device's own time for the frame with the same stamp."""
    ticks = {"device_ticks": message.ticks}
    return Companion(fields.stamp_ns(message.header), DepthFrame, ticks)


def encode_camera(frame: DepthFrame, t_ns: int, _sequence: int) -> Parts:
    """Return the intrinsics with the frame's time: P = [K 0], no distortion, R = identity."""
    return (restamped(_camera_at_0(frame.camera), t_ns),)


@lru_cache(maxsize=16)
def _camera_at_0(camera: CameraIntrinsics) -> bytes:
    _check_camera(camera)
    fx, fy, cx, cy = camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
    info = ros.sensor_msgs__msg__CameraInfo(
        fields.ros_header(0, DEPTH_OPTICAL_FRAME),
        camera.height_px,
        camera.width_px,
        "plumb_bob",
        d=np.zeros(5),
        k=np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1], dtype=np.float64),
        r=np.eye(3).ravel(),
        p=np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0], dtype=np.float64),
        binning_x=0,
        binning_y=0,
        roi=ros.sensor_msgs__msg__RegionOfInterest(0, 0, 0, 0, do_rectify=False),
    )
    return bytes(typestore().serialize_cdr(info, CAMERA_TYPE, little_endian=True))


def decode_camera(info: ros.sensor_msgs__msg__CameraInfo, _sequence: int) -> CameraInfo:
    """Return the intrinsics, refusing what `CameraIntrinsics` cannot tell."""
    if np.any(info.d != 0.0):
        raise ValueError(f"camera distorts: D = {info.d.tolist()}; expected rectified images")
    fx, skew, cx, _, fy, cy, *_ = info.k.tolist()
    if skew != 0.0:
        raise ValueError(f"camera has skew {skew}; expected 0")
    camera = CameraIntrinsics(info.width, info.height, fx, fy, cx, cy)
    _check_camera(camera)
    return CameraInfo(fields.stamp_ns(info.header), camera)


def _check_camera(camera: CameraIntrinsics) -> None:
    numbers = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
    if not (np.isfinite(numbers).all() and min(camera.fx_px, camera.fy_px) > 0.0):
        raise ValueError(f"camera has fx, fy, cx, cy = {numbers} px; expected finite, fx, fy > 0")
    if min(camera.width_px, camera.height_px) < 1:
        raise ValueError(f"camera is {camera.width_px}x{camera.height_px} px")
