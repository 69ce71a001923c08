"""Depth frames as sensor_msgs/msg/CompressedImage under RVL; reasons of failure as ValueError.

The message is that of ROS's compressed_depth_image_transport: twelve bytes for that transport's
quantisation of floating-point depth, all 0 here, width and height as uint32, and the code.
"""

from __future__ import annotations

import struct
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.stores import ros2_humble as ros

from acquisition.kernel_cache import are_cached, note_use
from acquisition.messages import ros_fields as fields
from acquisition.messages.depth import DEPTH_ENCODING, DepthImage, depth_pixels
from acquisition.messages.frames import DEPTH_OPTICAL_FRAME
from drivers.samples import DepthFrame

RVL_TOPIC = "/depth/image/compressedDepth"
COMPRESSED_TYPE = "sensor_msgs/msg/CompressedImage"
RVL_FORMAT = f"{DEPTH_ENCODING}; compressedDepth rvl"
_HEAD = struct.Struct("<iffII")  # format, two parameters; width and height
_WORD_BYTES = 4
_Unsigned = TypeVar("_Unsigned", np.uint8, np.uint16)
_MOST_PIXELS = 1 << 30


def encode_rvl(
    frame: DepthFrame, t_ns: int, _sequence: int
) -> ros.sensor_msgs__msg__CompressedImage:
    """Return the image, smaller by a factor of six for a Kinect's."""
    from acquisition.messages.rvl_kernels import MOST_BYTES_PER_PIXEL, pack

    pixels = depth_pixels(frame)
    height, width = frame.depth_mm.shape
    data = np.zeros(_HEAD.size + MOST_BYTES_PER_PIXEL * pixels.size + 8, dtype=np.uint8)
    _HEAD.pack_into(data.data, 0, 0, 0.0, 0.0, width, height)
    used = pack(_read_only(pixels), data[_HEAD.size :])
    return ros.sensor_msgs__msg__CompressedImage(
        fields.ros_header(t_ns, DEPTH_OPTICAL_FRAME), RVL_FORMAT, data[: _HEAD.size + used]
    )


def rvl_is_cached() -> bool:
    """Tell whether the code was compiled earlier by this installation."""
    from acquisition.messages.rvl_kernels import pack, unpack

    return are_cached([pack, unpack])


def prepare_rvl() -> None:
    """Load the code, and compile it where it never was; seconds that no queue has room for."""
    from acquisition.messages.rvl_kernels import MOST_BYTES_PER_PIXEL, pack, unpack

    pixels, code = np.zeros(1, dtype=np.uint16), np.zeros(MOST_BYTES_PER_PIXEL + 8, dtype=np.uint8)
    used = pack(_read_only(pixels), code)
    unpack(_read_only(code[:used]), pixels.size, pixels)
    note_use([pack, unpack])


def _read_only(array: NDArray[_Unsigned]) -> NDArray[_Unsigned]:
    """Return a view that cannot be written, so that the kernels are compiled only once."""
    view = array.view()
    view.flags.writeable = False
    return view


def decode_rvl(image: ros.sensor_msgs__msg__CompressedImage, sequence: int) -> DepthImage:
    """Return the image; refuse other formats, and code that is not exactly one image."""
    from acquisition.messages.rvl_kernels import unpack

    if image.format != RVL_FORMAT:
        raise ValueError(f"image is {image.format!r}; expected {RVL_FORMAT!r}")
    if image.data.size < _HEAD.size or (image.data.size - _HEAD.size) % _WORD_BYTES:
        raise ValueError(f"image of {image.data.size} bytes; expected whole words behind a head")
    *_, width, height = _HEAD.unpack_from(image.data.data)
    code = _read_only(np.ascontiguousarray(image.data[_HEAD.size :]))
    count = width * height
    # Only what makes sense gets memory: nothing vouches for the size.
    nothing = np.empty(0, dtype=np.uint16)
    if not 0 < count <= _MOST_PIXELS or not unpack(code, count, nothing):
        raise ValueError(f"the code is not that of {width}x{height} px")
    depth_mm = np.zeros(count, dtype=np.uint16)
    unpack(code, count, depth_mm)
    depth_mm = depth_mm.reshape(height, width)
    depth_mm.flags.writeable = False
    return DepthImage(fields.stamp_ns(image.header), depth_mm, sequence)
