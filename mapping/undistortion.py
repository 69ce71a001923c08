"""The sensor's distortion, pixel by pixel, as a plate rig measures it, and readings without it.

A pixel of a disparity sensor reads d + m, m being the mean of what all plates were off their
planes there, so that

    z' = f b / (d - m) = z / (1 - z m / (f b)).

m holds no tilt and no offset: each plate's plane has taken them, and bias(z) has what is left.
"""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.errors import reason_of
from drivers.samples import CameraIntrinsics
from mapping.calibration_file import DeviceIdentity
from mapping.errors import MappingError

Float32Array = NDArray[np.float32]

_KEYS = ("mean_px", "disparity_px_m", "model", "serial")
# A Kinect V1's is below 1 px; a map beyond this is of something else.
_LARGEST_PX = 10.0


@dataclass(frozen=True, slots=True)
class Undistortion:
    """What to take off each pixel.

    Attributes:
        inverse_m: (height, width) m / (f b), 1/m; 0 where no plate was.
        device: which camera it was measured on.
        where: the file's name, for messages.
    """

    inverse_m: Float32Array
    device: DeviceIdentity
    where: str

    def check_camera(self, camera: CameraIntrinsics) -> None:
        """Refuse images of another size.

        Raises:
            MappingError: they have one.
        """
        height, width = self.inverse_m.shape
        if (camera.height_px, camera.width_px) != (height, width):
            raise MappingError(
                f"{self.where} is for images of {width} x {height}, the depth frames have "
                f"{camera.width_px} x {camera.height_px}; measure it in the mode that you map in"
            )

    def check_device(self, found: DeviceIdentity) -> None:
        """Refuse the depth camera of a recording that is not the one that was measured.

        Raises:
            MappingError: both serial numbers are known, and they differ.
        """
        remedy = "leave --undistortion out, or give that device's"
        self.device.refuse_other(found, self.where, remedy)

    def straighten(self, z_m: Float32Array, range_min_m: float, range_max_m: float) -> int:
        """Correct distances in place; return how many are left.

        Args:
            z_m: (height, width) along the optical axis; 0 = none.
            range_min_m, range_max_m: what is outside afterwards is dropped.
        """
        z_m /= np.float32(1.0) - z_m * self.inverse_m
        inside = (z_m >= np.float32(range_min_m)) & (z_m <= np.float32(range_max_m))
        z_m[~inside] = 0.0
        return int(np.count_nonzero(inside))


def read_undistortion(path: Path) -> Undistortion:
    """Read the undistortion.npz of `terravibe calibrate plate --undistortion`.

    Raises:
        MappingError: it cannot be read, or is no such file.
    """
    try:
        # Without pickles: a file from elsewhere must not run code.
        with np.load(path, allow_pickle=False) as file:
            missing = [key for key in _KEYS if key not in file]
            if missing:
                raise MappingError(
                    f"{path} has no {' and no '.join(missing)}; expected a map that `terravibe "
                    "calibrate plate --undistortion` wrote"
                )
            mean_px, focal_baseline = file["mean_px"], float(file["disparity_px_m"])
            device = DeviceIdentity(model=str(file["model"]), serial=str(file["serial"]))
        known = np.isfinite(mean_px)
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        # NumPy takes whatever it does not know for a pickle, and advises to trust it.
        reason = "no NumPy archive" if "pickle" in str(error) else reason_of(error)
        raise MappingError(f"cannot read {path}: {reason}; expected an undistortion.npz") from error
    largest = float(np.abs(mean_px[known]).max(initial=0.0))
    if mean_px.ndim != 2 or not focal_baseline > 0.0 or largest > _LARGEST_PX:
        raise MappingError(
            f"{path}: a map of shape {mean_px.shape} up to {largest:g} px, f b = "
            f"{focal_baseline:g} px m; expected an image within {_LARGEST_PX:g} px and f b > 0"
        )
    inverse_m = np.where(known, mean_px, 0.0) / focal_baseline
    return Undistortion(inverse_m.astype(np.float32), device, str(path))
