"""The depth frames of one cell: out of a recording, or out of a folder of images."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.reader import StreamReader
from calibration_rigs.errors import RigError
from calibration_rigs.plate_rig.manifest import Rig
from drivers.samples import CameraIntrinsics, DepthFrame
from mapping.calibration_file import DeviceIdentity
from mapping.recorded import depth_device

# Frames beyond these tell nothing new and only take memory: 123 MB at 640 x 480.
FRAMES_AT_MOST = 200
_IMAGES = (".png", ".pgm")
_FORMATS = ("PNG", "PPM")
_DEPTH_MODES = ("I", "I;16", "I;16B")


@dataclass(frozen=True, slots=True)
class CellFrames:
    """What the camera saw in one cell.

    Attributes:
        depth_mm: (frames, height, width) uint16; 0 = no return.
        camera: intrinsics.
        device: model and serial; "" where nobody said.
        sha256: of the files' bytes.
    """

    depth_mm: NDArray[np.uint16]
    camera: CameraIntrinsics
    device: DeviceIdentity
    sha256: str


def read_frames(path: Path, rig: Rig) -> CellFrames:
    """Read the first FRAMES_AT_MOST frames of a recording or of a folder of images.

    Raises:
        RigError: not there, no depth frames, images of several sizes, or a folder whose manifest
            does not give the intrinsics.
        StreamError: the recording cannot be read.
    """
    if path.is_dir():
        return _read_folder(path, rig)
    if not path.is_file():
        raise RigError(f"{path} is not there; expected a recording or a folder of images")
    with FinishedFile(path) as source:
        reader = StreamReader(source)
        frames = list(_copies(reader))
        device = depth_device(reader.metadata)
    if not frames:
        raise RigError(f"{path} holds no depth frame; expected /depth/image and its camera")
    camera = frames[0].camera
    if any(frame.camera != camera for frame in frames):
        raise RigError(f"{path}: the camera changes within the recording; expected one")
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return CellFrames(np.stack([frame.depth_mm for frame in frames]), camera, device, digest)


def _copies(reader: StreamReader) -> Iterator[DepthFrame]:
    frames = 0
    for message in reader:
        if isinstance(message.sample, DepthFrame):
            yield message.sample
            frames += 1
            if frames == FRAMES_AT_MOST:
                return


def _read_folder(folder: Path, rig: Rig) -> CellFrames:
    if rig.intrinsics_px is None:
        raise RigError(f"{folder} is a folder of images; give intrinsics_px under [rig]")
    paths = sorted(p for p in folder.iterdir() if p.suffix.lower() in _IMAGES)[:FRAMES_AT_MOST]
    if not paths:
        raise RigError(f"{folder} has no {' or '.join(_IMAGES)} files; expected depth images")
    digest = hashlib.sha256()
    images = [_read_image(path) for path in paths]
    for path, image in zip(paths, images, strict=True):
        if image.shape != images[0].shape:
            raise RigError(f"{path} has another size than {paths[0].name}; expected one camera")
        digest.update(path.read_bytes())
    height, width = images[0].shape
    camera = CameraIntrinsics(width, height, *rig.intrinsics_px)
    device = DeviceIdentity(model=rig.model, serial=rig.serial)
    return CellFrames(np.stack(images), camera, device, digest.hexdigest())


def _read_image(path: Path) -> NDArray[np.uint16]:
    try:
        with Image.open(path, formats=_FORMATS) as image:
            if image.mode not in _DEPTH_MODES:
                raise RigError(f"{path} has mode {image.mode}; expected 16-bit grey millimetres")
            return np.asarray(image).astype(np.uint16)
    # Pillow reports damage by several classes, SyntaxError and EOFError among them.
    except (OSError, SyntaxError, ValueError, EOFError, Image.DecompressionBombError) as error:
        raise RigError(f"cannot read {path}: {error}; expected a whole depth image") from error
