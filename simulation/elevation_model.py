"""A crop of a real elevation model as the ground of a simulation."""

from __future__ import annotations

import warnings
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from simulation.errors import SimulationError
from simulation.ground_layout import grid_shape
from simulation.height_grid import HeightGrid

Float64Array = NDArray[np.float64]

# Pixels around the crop that a cubic spline wants for its ends.
_MARGIN_PX = 3


@dataclass(frozen=True, slots=True)
class _Raster:
    """Heights at increasing positions: (len(y), len(x)), NaN = no data."""

    x_m: Float64Array
    y_m: Float64Array
    height_m: Float64Array


def read_elevation_model(
    path: Path, size_m: float, spacing_m: float, centre_m: tuple[float, float] | None = None
) -> HeightGrid:
    """Return a square crop, resampled by a cubic spline.

    The crop's centre becomes x = y = 0 and the height there zero. What is finer than the file's
    own spacing stays smooth.

    Args:
        path: GeoTIFF (or what else GDAL reads) in projected metres, north up; or .npz with
            `height_m` (rows along y, columns along x) and `spacing_m`, node [0, 0] at (0, 0).
        size_m: edge of the crop.
        spacing_m: distance of the grid's nodes.
        centre_m: centre of the crop in the file's coordinates; by default the file's centre.

    Raises:
        SimulationError: the file cannot be read, is not in metres, or the crop does not lie
            inside it or holds no data somewhere.
    """
    half = 0.5 * size_m
    rows, columns = grid_shape((-half, half, -half, half), spacing_m)
    raster = _read_npz(path) if path.suffix == ".npz" else _read_geotiff(path)
    if centre_m is None:
        centre_m = (
            0.5 * float(raster.x_m[0] + raster.x_m[-1]),
            0.5 * float(raster.y_m[0] + raster.y_m[-1]),
        )
    crop = _crop(path, raster, centre_m, half)
    spline = RectBivariateSpline(
        crop.y_m - centre_m[1],
        crop.x_m - centre_m[0],
        crop.height_m,
        kx=min(3, crop.y_m.size - 1),
        ky=min(3, crop.x_m.size - 1),
    )
    x_m, y_m = _positions(columns, spacing_m) - half, _positions(rows, spacing_m) - half
    heights = spline(y_m, x_m) - spline(0.0, 0.0)
    return HeightGrid(-half, -half, spacing_m, heights.astype(np.float32))


def _crop(path: Path, raster: _Raster, centre_m: tuple[float, float], half_m: float) -> _Raster:
    """Return the pixels that the crop needs."""
    spans = []
    for axis, centre in zip((raster.x_m, raster.y_m), centre_m, strict=True):
        if centre - half_m < axis[0] or centre + half_m > axis[-1]:
            raise SimulationError(
                f"a crop of {2 * half_m:g} m around {centre_m} leaves {path}, which spans "
                f"{raster.x_m[0]:g} to {raster.x_m[-1]:g} and {raster.y_m[0]:g} to "
                f"{raster.y_m[-1]:g} m; choose a smaller crop or another centre"
            )
        first = int(np.searchsorted(axis, centre - half_m, "right")) - 1 - _MARGIN_PX
        last = int(np.searchsorted(axis, centre + half_m)) + _MARGIN_PX
        spans.append(slice(max(first, 0), last + 1))
    along_x, along_y = spans
    height_m = raster.height_m[along_y, along_x]
    if holes := int(np.count_nonzero(~np.isfinite(height_m))):
        raise SimulationError(
            f"the crop of {path} around {centre_m} has {holes} pixels without data; choose another"
        )
    return _Raster(raster.x_m[along_x], raster.y_m[along_y], height_m)


def _read_npz(path: Path) -> _Raster:
    try:
        with np.load(path) as arrays:
            height_m = np.asarray(arrays["height_m"], np.float64)
            spacing_m = float(arrays["spacing_m"])
    except (OSError, KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise SimulationError(
            f"{path} is no elevation model ({str(error).splitlines()[0]}); expected an .npz file "
            "with height_m (2-D) and spacing_m"
        ) from error
    if height_m.ndim != 2 or min(height_m.shape) < 2 or not spacing_m > 0.0:
        raise SimulationError(
            f"{path} has heights of shape {height_m.shape} every {spacing_m} m; expected at least "
            "2 x 2 and a positive spacing"
        )
    rows, columns = height_m.shape
    return _Raster(_positions(columns, spacing_m), _positions(rows, spacing_m), height_m)


def _read_geotiff(path: Path) -> _Raster:
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as file:
                crs, transform = file.crs, file.transform
                height_m = file.read(1, masked=True).astype(np.float64).filled(np.nan)
    except RasterioError as error:
        raise SimulationError(
            f"cannot read {path}: {str(error).splitlines()[0]}; give a GeoTIFF or .npz file"
        ) from error
    if crs is not None and not (crs.is_projected and crs.linear_units_factor[1] == 1.0):
        raise SimulationError(f"{path} is not in metres ({crs}); reproject it to a metric system")
    if transform.b != 0.0 or transform.d != 0.0 or transform.a <= 0.0 or transform.e >= 0.0:
        raise SimulationError(f"{path} is not georeferenced north up; warp it with gdalwarp")
    rows, columns = height_m.shape
    if min(rows, columns) < 2:
        raise SimulationError(f"{path} has {rows} x {columns} pixels; expected at least 2 x 2")
    x_m = transform.c + 0.5 * transform.a + _positions(columns, transform.a)
    y_m = transform.f + 0.5 * transform.e + _positions(rows, transform.e)
    return _Raster(x_m, y_m[::-1], height_m[::-1])


def _positions(number: int, spacing_m: float) -> Float64Array:
    return spacing_m * np.arange(number, dtype=np.float64)
