"""Kinect V1 and its recordings (`.oni`) through OpenNI2.

libOpenNI2 runs in a process of its own (`drivers.depth.openni_helper`): what crashes or hangs in
there becomes a DriverError here.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from drivers.checks import check_intrinsics, check_positive
from drivers.depth.openni_library import find_library, usual_folders
from drivers.depth.openni_link import OpenNiLink
from drivers.depth.openni_protocol import End, Ready
from drivers.errors import DriverError, EndOfSource
from drivers.faults import NO_FAULTS, Faults
from drivers.samples import CameraIntrinsics, DepthFrame
from drivers.source import SourceInfo, TickCounter

# What FreenectDriver reports for Kinect V1: 58.5 and 45.6 degrees.
KINECT_FOV_RAD = (1.0210, 0.7959)

_TICK_HZ = 1_000_000  # OpenNI's own unit, whatever the device counts

_ONI_MAGIC = b"NI10"


def intrinsics_from_fov(
    width_px: int, height_px: int, fov_rad: Sequence[float]
) -> CameraIntrinsics:
    """Return the intrinsics of a symmetric field of view.

    The outer edges of the image, half a pixel outside the outer pixel centres, are at half the
    angle: f = (size / 2) / tan(fov / 2), c = (size - 1) / 2.
    """
    return CameraIntrinsics(
        width_px,
        height_px,
        width_px / 2 / math.tan(fov_rad[0] / 2),
        height_px / 2 / math.tan(fov_rad[1] / 2),
        (width_px - 1) / 2,
        (height_px - 1) / 2,
    )


def decimated(camera: CameraIntrinsics, step: int) -> CameraIntrinsics:
    """Return the intrinsics of every `step`-th pixel of every `step`-th row, the first included.

    Pixel i of the result is pixel step * i of the image, so u' = u / step, and with it f and c.
    """
    return CameraIntrinsics(
        -(-camera.width_px // step),
        -(-camera.height_px // step),
        camera.fx_px / step,
        camera.fy_px / step,
        camera.cx_px / step,
        camera.cy_px / step,
    )


class OpenNiDepth:
    """A Kinect V1, another camera that OpenNI2 knows, or an `.oni` recording.

    Args:
        device: the URI of a camera; None for the first one found.
        file: a recording to play instead of a camera.
        decimation: 1 gives all pixels (640x480); 2 gives every second pixel of every second row
            (320x240), real returns all of them: averages would invent surfaces at edges.
        intrinsics_px: calibrated fx, fy, cx, cy in pixels of the full image; None to take the
            field of view that the device reports, or else that of a Kinect V1.
        open_timeout_s: the longest time that opening may take.
        silence_s: the longest time without a frame before the device is given up.
        stall_s: the longest time without a sign of life from libOpenNI2.
        library_folder: the folder of libOpenNI2.so; None for the usual places.
        name: the instance's name.
    """

    def __init__(
        self,
        *,
        device: str | None = None,
        file: Path | str | None = None,
        decimation: Literal[1, 2] = 1,
        intrinsics_px: Sequence[float] | None = None,
        open_timeout_s: float = 15.0,
        silence_s: float = 5.0,
        stall_s: float = 3.0,
        library_folder: Path | str | None = None,
        name: str = "depth",
    ) -> None:
        self._device = device
        self._file = None if file is None else Path(file)
        self._decimation = decimation
        self._intrinsics_px = None if intrinsics_px is None else tuple(intrinsics_px)
        self._open_timeout_s = open_timeout_s
        self._silence_s = silence_s
        self._stall_s = stall_s
        self._library_folders = (
            usual_folders() if library_folder is None else [Path(library_folder)]
        )
        self._name = name
        self._link: OpenNiLink | None = None
        self._camera: CameraIntrinsics | None = None
        self._first_index: int | None = None
        self._ended = False

    @property
    def name(self) -> str:
        """The instance's name."""
        return self._name

    @property
    def faults(self) -> Faults:
        """None: a frame that did not come is missing in the sequence numbers."""
        return NO_FAULTS

    def open(self) -> SourceInfo:
        """Start the helper process and have it open the device.

        Raises:
            DriverError: a setting is wrong, a library is missing, there is no such device or
                file, or libOpenNI2 refuses, crashes or does not answer.
        """
        self.close()
        try:
            self._check_settings()
            library_folder = find_library(self._library_folders)
        except DriverError as error:
            raise DriverError(f"{self._name}: {error}") from error
        try:
            self._link = OpenNiLink(
                library_folder,
                self._device or "" if self._file is None else str(self._file.resolve()),
                is_file=self._file is not None,
                silence_s=self._silence_s,
                stall_s=self._stall_s,
            )
            ready = self._link.wait_ready(self._open_timeout_s)
        except DriverError as error:
            self.close()
            raise self._named(error) from error
        self._first_index = None
        self._ended = False
        return self._describe(ready)

    def read(self, timeout_s: float) -> Sequence[DepthFrame]:
        """Return the next frame, or nothing if none came in time.

        Raises:
            DriverError: not open, unplugged, damaged file, or libOpenNI2 crashed or hangs; the
                source is closed then and may be opened again.
            EndOfSource: the recording has given its last frame.
        """
        if self._link is None or self._camera is None:
            raise DriverError(f"{self._name} is not open; call open() before read()")
        if self._ended:
            raise EndOfSource(f"{self._name}: end of {self._file}")
        try:
            received = self._link.next_frame(timeout_s, self._decimation)
        except DriverError as error:
            self.close()
            raise self._named(error) from error
        if received is None:
            return []
        if isinstance(received, End):
            self._ended = True
            raise EndOfSource(f"{self._name}: end of {self._file}")
        note, depth_mm = received
        depth_mm.flags.writeable = False
        if self._first_index is None:
            self._first_index = note.index
        return [
            DepthFrame(
                t_ns=note.t_ns if self._file is None else note.timestamp_us * 1000,
                depth_mm=depth_mm,
                camera=self._camera,
                sequence=note.index - self._first_index,
                device_ticks=note.timestamp_us,
            )
        ]

    def close(self) -> None:
        """End the helper process; harmless when there is none."""
        link, self._link = self._link, None
        if link is not None:
            link.stop()

    def _named(self, error: DriverError) -> DriverError:
        """Return an error of the link with the name of this device before its text."""
        what = self._file or self._device or "depth camera"
        return DriverError(f"{self._name}: {what} {error}")

    def _check_settings(self) -> None:
        if self._decimation not in (1, 2):
            raise DriverError(f"decimation is {self._decimation}; expected 1 or 2")
        check_positive("open_timeout_s", self._open_timeout_s)
        check_positive("silence_s", self._silence_s)
        check_positive("stall_s", self._stall_s)
        if self._intrinsics_px is not None:
            check_intrinsics(self._intrinsics_px)
        if self._file is not None:
            if self._device is not None:
                raise DriverError(
                    f"device is {self._device!r} and file is {self._file}; expected one of them"
                )
            _check_magic(self._file)
        if importlib.util.find_spec("openni") is None:
            raise DriverError("the package openni is missing; pip install 'terravibe[kinect]'")

    def _describe(self, ready: Ready) -> SourceInfo:
        if self._intrinsics_px is not None:
            full = CameraIntrinsics(ready.width_px, ready.height_px, *self._intrinsics_px)
            origin = "settings"
        else:
            fov_rad = ready.fov_rad or KINECT_FOV_RAD
            full = intrinsics_from_fov(ready.width_px, ready.height_px, fov_rad)
            origin = "field of view, " + ("reported" if ready.fov_rad else "Kinect V1 nominal")
        self._camera = decimated(full, self._decimation)
        details = {
            "uri": ready.uri if self._file is None else self._file.name,
            "mode": f"{ready.width_px}x{ready.height_px} at {ready.rate_hz} Hz, 1 mm",
            "decimation": str(self._decimation),
            "intrinsics_from": origin,
            "device_tick_hz": str(_TICK_HZ),
        }
        if ready.frames is not None:
            details["frames"] = str(ready.frames)
        return SourceInfo(
            name=self._name,
            model=f"{ready.vendor} {ready.model}".strip(),
            serial="",
            produces=(DepthFrame,),
            time_base="monotonic" if self._file is None else "recorded",
            details=details,
            nominal_rate_hz={DepthFrame: float(ready.rate_hz)},
            counter=TickCounter(_TICK_HZ),
        )


def _check_magic(file: Path) -> None:
    """Raise DriverError unless the file can be read and starts like an OpenNI recording."""
    try:
        with file.open("rb") as stream:
            magic = stream.read(len(_ONI_MAGIC))
    except OSError as error:
        raise DriverError(
            f"cannot read {file}: {error}; expected an .oni recording, check the path"
        ) from error
    if magic != _ONI_MAGIC:
        raise DriverError(
            f"{file} starts with {magic!r}; expected {_ONI_MAGIC!r}, an OpenNI recording"
        )
