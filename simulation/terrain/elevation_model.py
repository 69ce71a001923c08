"""A crop of a real elevation model as the ground of a simulation."""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from simulation.errors import SimulationError
from simulation.terrain.ground_layout import grid_shape
from simulation.terrain.height_grid import HeightGrid

Float64Array = NDArray[np.float64]

# Pixels around the crop that a cubic spline wants for its ends.
_MARGIN_PX = 3


@dataclass(frozen=True, slots=True)
class _Raster:
    """Positions, increasing, and what reads the heights of a slice of y and one of x."""

    x_m: Float64Array
    y_m: Float64Array
    read: Callable[[slice, slice], Float64Array]


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
    with (_npz if path.suffix == ".npz" else _geotiff)(path) as raster:
        x_centre, y_centre = centre_m or (raster.x_m[[0, -1]].mean(), raster.y_m[[0, -1]].mean())
        along_x = _span(path, raster.x_m, float(x_centre), half)
        along_y = _span(path, raster.y_m, float(y_centre), half)
        known_m = raster.read(along_y, along_x)
    if holes := int(np.count_nonzero(~np.isfinite(known_m))):
        raise SimulationError(f"{holes} pixels of the crop of {path} hold no data; choose another")
    known_x, known_y = raster.x_m[along_x] - x_centre, raster.y_m[along_y] - y_centre
    orders = {"kx": min(3, known_y.size - 1), "ky": min(3, known_x.size - 1)}
    spline = RectBivariateSpline(known_y, known_x, known_m, **orders)
    x_m, y_m = _positions(columns, spacing_m) - half, _positions(rows, spacing_m) - half
    heights = spline(y_m, x_m) - spline(0.0, 0.0)
    return HeightGrid(-half, -half, spacing_m, heights.astype(np.float32))


def _span(path: Path, axis_m: Float64Array, centre_m: float, half_m: float) -> slice:
    """Return the pixels of an axis that the crop needs."""
    if not axis_m[0] <= centre_m - half_m <= centre_m + half_m <= axis_m[-1]:
        raise SimulationError(
            f"a crop from {centre_m - half_m:g} to {centre_m + half_m:g} m leaves {path}, which "
            f"spans {axis_m[0]:g} to {axis_m[-1]:g} m; choose a smaller crop or another centre"
        )
    first = int(np.searchsorted(axis_m, centre_m - half_m, "right")) - 1 - _MARGIN_PX
    last = int(np.searchsorted(axis_m, centre_m + half_m)) + _MARGIN_PX
    return slice(max(first, 0), min(last + 1, axis_m.size))


@contextmanager
def _npz(path: Path) -> Iterator[_Raster]:
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
    y_m, x_m = (_positions(number, spacing_m) for number in height_m.shape)
    yield _Raster(x_m, y_m, lambda along_y, along_x: height_m[along_y, along_x])


@contextmanager
def _geotiff(path: Path) -> Iterator[_Raster]:
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError
    from rasterio.windows import Window

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            file = rasterio.open(path)
        with file:
            _check_georeference(path, file)
            (rows, columns), place = file.shape, file.transform
            x_m = place.c + 0.5 * place.a + _positions(columns, place.a)
            y_m = (place.f + 0.5 * place.e + _positions(rows, place.e))[::-1]

            def read(along_y: slice, along_x: slice) -> Float64Array:
                """Return heights in metres, south first; NaN where the file has none."""
                lines = slice(rows - along_y.stop, rows - along_y.start)
                pixels = file.read(1, window=Window.from_slices(lines, along_x), masked=True)
                height_m = pixels.astype(np.float64) * file.scales[0] + file.offsets[0]
                return np.asarray(height_m.filled(np.nan)[::-1], np.float64)

            yield _Raster(x_m, y_m, read)
    except RasterioError as error:
        raise SimulationError(
            f"cannot read {path}: {str(error).splitlines()[0]}; give a GeoTIFF or .npz file"
        ) from error


def _check_georeference(path: Path, file: Any) -> None:  # noqa: ANN401 - rasterio is untyped
    """Refuse a raster that is not in metres, north up, of 2 x 2 pixels at least."""
    crs, place = file.crs, file.transform
    if crs is not None and not (crs.is_projected and crs.linear_units_factor[1] == 1.0):
        raise SimulationError(f"{path} is not in metres ({crs}); reproject it to a metric system")
    if place.b != 0.0 or place.d != 0.0 or place.a <= 0.0 or place.e >= 0.0:
        raise SimulationError(f"{path} is not georeferenced north up; warp it with gdalwarp")
    if min(file.shape) < 2:
        raise SimulationError(f"{path} has {file.shape} pixels; expected at least 2 x 2")


def _positions(number: int, spacing_m: float) -> Float64Array:
    return spacing_m * np.arange(number, dtype=np.float64)
