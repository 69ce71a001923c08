"""One depth stream of libOpenNI2; used by the helper process alone.

Facts of OpenNI 2.2 that shape this: `initialize` may be called once per process; `read_frame`
waits for ever, so the stream is waited for first; `seek` hangs and is never called; a recording
is repeated unless told otherwise and its end looks like a silence; a frame's buffer is only
valid until the next call.
"""

from __future__ import annotations

import ctypes
import math
import os
import time
from pathlib import Path

from drivers.depth.openni_library import FREENECT_ADVICE, driver_folder, has_freenect_driver
from drivers.depth.openni_protocol import FrameNote, HelperSettings, Ready

_UNTHROTTLED = -1.0  # playback speed: the next frame is read when it is waited for
_MAX_SIDE_PX = 4096
_LIVE_SIZE_PX = (640, 480)  # all that Kinect V1 offers


class CameraError(Exception):
    """What was found, expected and to be done, to follow the device's name."""


def explain(error: BaseException) -> str:
    """Return one line about an error of this module or of OpenNI, to follow the device's name."""
    from openni.utils import OpenNIError

    if isinstance(error, CameraError):
        return str(error)
    if isinstance(error, OpenNIError):
        status, text, _ = error.args
        reason = text.decode(errors="replace") if isinstance(text, bytes) else text
        reason = reason or str(status)
        return f"is refused by OpenNI2: {reason}; expected a device or a file that it can open"
    return f"failed with {type(error).__name__}: {error}"


class Camera:
    """A device, or a recording that is not repeated.

    Args:
        settings: what to open.

    Raises:
        CameraError: no camera, no depth in millimetres, or a mirrored recording.
        OpenNIError: OpenNI refuses.
    """

    def __init__(self, settings: HelperSettings) -> None:
        from openni import openni2

        self._openni2 = openni2
        self._settings = settings
        openni2.initialize(settings.library_folder)
        self._device = openni2.Device(self._uri())
        self._stream = self._device.create_depth_stream()
        if self._stream is None:
            raise CameraError("has no depth stream; expected a depth camera or its recording")
        if settings.is_file:
            self._device.playback.set_repeat_enabled(False)
            self._device.playback.set_speed(_UNTHROTTLED)
        else:
            self._choose_mode()
        self._mode = self._stream.get_video_mode()
        self._check()

    def describe(self) -> Ready:
        """Return what was opened."""
        info = self._device.get_device_info()
        return Ready(
            vendor=info.vendor.decode(errors="replace"),
            model=info.name.decode(errors="replace"),
            uri=info.uri.decode(errors="replace"),
            width_px=self._mode.resolutionX,
            height_px=self._mode.resolutionY,
            rate_hz=self._mode.fps,
            fov_rad=self._field_of_view(),
            frames=self._number_of_frames(),
        )

    def start(self) -> None:
        """Let the frames flow."""
        self._stream.start()

    def wait(self, timeout_s: float) -> bool:
        """Return whether a frame is there; blocks no longer than `timeout_s`."""
        return self._openni2.wait_for_any_stream([self._stream], timeout_s) is not None

    def read(self) -> tuple[FrameNote, bytes]:
        """Return the frame that is there, with no slot chosen, and a copy of its pixels.

        Raises:
            CameraError: the frame has not the announced size.
        """
        frame = self._stream.read_frame()
        t_ns = time.monotonic_ns()
        width_px, height_px = self._mode.resolutionX, self._mode.resolutionY
        if (frame.width, frame.height, frame.stride) != (width_px, height_px, 2 * width_px):
            raise CameraError(
                f"gave {frame.width}x{frame.height} pixels in rows of {frame.stride} bytes; "
                f"expected {width_px}x{height_px} as announced, switch off cropping"
            )
        pixels = ctypes.string_at(frame.data, 2 * width_px * height_px)
        note = FrameNote(-1, t_ns, frame.timestamp, frame.frameIndex)
        frame.close()
        return note, pixels

    def close(self) -> None:
        """Stop the stream and close the device."""
        self._stream.stop()
        self._device.close()

    def _uri(self) -> bytes:
        if self._settings.device:
            return os.fsencode(self._settings.device)
        found: list[bytes] = self._openni2.Device.enumerate_uris()
        if found:
            return found[0]
        folder = Path(self._settings.library_folder)
        if has_freenect_driver(folder):
            raise CameraError(
                "is not found by OpenNI2; expected a Kinect V1, check its plug, its 12 V supply "
                "and the udev rules in docs/devices/udev.md"
            )
        raise CameraError(
            "is not found by OpenNI2, which has no libFreenectDriver.so in "
            f"{driver_folder(folder)}; for a Kinect V1 {FREENECT_ADVICE}"
        )

    def _choose_mode(self) -> None:
        """Take 640x480 if there is a choice, and switch mirroring off."""
        millimetres = self._openni2.PIXEL_FORMAT_DEPTH_1_MM
        modes = [
            mode
            for mode in self._stream.get_sensor_info().videoModes
            if mode.pixelFormat == millimetres
        ]
        modes.sort(key=lambda mode: (mode.resolutionX, mode.resolutionY) != _LIVE_SIZE_PX)
        # Some drivers refuse to be set to the mode that they are in.
        if modes and bytes(modes[0]) != bytes(self._stream.get_video_mode()):
            self._stream.set_video_mode(modes[0])
        if self._is_mirrored():
            self._stream.set_mirroring_enabled(False)

    def _check(self) -> None:
        mode = self._mode
        if mode.pixelFormat != self._openni2.PIXEL_FORMAT_DEPTH_1_MM:
            raise CameraError(
                f"gives pixel format {mode.pixelFormat.value}; expected 100, whole millimetres, "
                "choose that mode"
            )
        if not (0 < mode.resolutionX <= _MAX_SIDE_PX and 0 < mode.resolutionY <= _MAX_SIDE_PX):
            raise CameraError(
                f"announces {mode.resolutionX}x{mode.resolutionY} pixels; expected up to "
                f"{_MAX_SIDE_PX} a side, the recording is damaged"
            )
        if self._is_mirrored():
            raise CameraError(
                "is mirrored; expected it as seen, record with mirroring switched off"
            )

    def _number_of_frames(self) -> int | None:
        """Return how many frames a recording has; one that was never closed does not say."""
        if not self._settings.is_file:
            return None
        frames: int = self._stream.get_number_of_frames()
        return frames if frames > 0 else None

    def _is_mirrored(self) -> bool:
        try:
            return bool(self._stream.get_mirroring_enabled())
        except self._openni2.OpenNIError:  # the stream knows no mirroring
            return False

    def _field_of_view(self) -> tuple[float, float] | None:
        try:
            fov_rad = self._stream.get_horizontal_fov(), self._stream.get_vertical_fov()
        except self._openni2.OpenNIError:  # the stream does not say
            return None
        return fov_rad if all(0.0 < angle < math.pi for angle in fov_rad) else None
