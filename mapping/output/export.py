"""The map in the formats of other programs: GeoTIFF, PLY mesh, 16-bit PNG."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.errors import MappingError
from mapping.files import write_whole
from mapping.ground.fusion import fuse_map
from mapping.ground.layers import derive
from mapping.judging.evaluation import CONFIRMED
from mapping.output.netcdf import FRAME, software

# A right-handed metric plane that is tied to no planet: the terrain frame.
_LOCAL_CRS = (
    'LOCAL_CS["terravibe terrain frame",UNIT["metre",1],'
    'AXIS["Easting",EAST],AXIS["Northing",NORTH]]'
)
# Value 0 of the PNG means unknown; heights take 1 to 65535.
_PNG_LAST = 65535
_PNG_SCALE_MIN_M = 1e-6
# Guesses are part of a mesh, flying pixels are not.
_IN_MESH = (*CONFIRMED, CellState.FILLED, CellState.OCCLUDED)


def export(map_: ElevationMap, path: Path) -> None:
    """Write a map in the format that the extension of `path` names: .tif, .tiff, .ply or .png.

    Raises:
        MappingError: the extension is not known, or the file cannot be written.
    """
    encode = _FORMATS.get(path.suffix.lower())
    if encode is None:
        raise MappingError(
            f"cannot export to {path.name}: expected a name that ends in {', '.join(_FORMATS)} "
            "or .nc"
        )
    write_whole(path, encode(map_))


def geotiff(map_: ElevationMap) -> bytes:
    """Return a GeoTIFF of float32 bands, NaN = unknown.

    Elevation, sigma, lower, upper (m) and state; slope (rad), roughness, step (m) and
    traversability of `mapping.ground.layers`; height, sigma and bounds of `mapping.ground.fusion`.

    Row 0 is the largest y (north up); the reference system is a local one in metres.
    """
    # Loads GDAL: only when a GeoTIFF is asked for.
    from rasterio import Affine
    from rasterio.io import MemoryFile

    bands = _bands(map_)
    edge_m, half_m = map_.resolution_m, 0.5 * map_.resolution_m
    left_m, top_m = map_.x_m[0] - half_m, map_.y_m[-1] + half_m
    rows, columns = map_.state.shape
    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff",
            width=columns,
            height=rows,
            count=len(bands),
            dtype="float32",
            nodata=np.nan,
            crs=_LOCAL_CRS,
            transform=Affine(edge_m, 0.0, left_m, 0.0, -edge_m, top_m),
            compress="deflate",
            predictor=3,
        ) as file:
            file.write(np.stack([band[::-1] for _, band in bands.values()]))
            file.descriptions = tuple(bands)
            file.units = tuple(unit for unit, _ in bands.values())
            file.update_tags(
                SOFTWARE=software(),
                FRAME=FRAME,
                STATES=_state_names(),
                ARRAYS_SHA256=map_.sha256(),
            )
        content: bytes = memory.read()
    return content


def _bands(map_: ElevationMap) -> dict[str, tuple[str, NDArray[np.floating]]]:
    """Return unit and layer (rows, columns), row 0 = smallest y, of each band of a GeoTIFF."""
    layers, fused = derive(map_), fuse_map(map_)
    return {
        "elevation": ("m", map_.elevation_m),
        "sigma": ("m", map_.sigma_m),
        "lower": ("m", map_.lower_m),
        "upper": ("m", map_.upper_m),
        "state": ("1", map_.state.astype(np.float32)),
        "slope": ("rad", layers.slope_rad),
        "roughness": ("m", layers.roughness_m),
        "step": ("m", layers.step_m),
        "traversability": ("1", layers.traversability),
        "fused_elevation": ("m", fused.elevation_m),
        "fused_sigma": ("m", np.sqrt(fused.variance_m2)),
        "fused_lower": ("m", fused.lower_m),
        "fused_upper": ("m", fused.upper_m),
    }


def ply(map_: ElevationMap) -> bytes:
    """Return a binary little-endian PLY mesh in metres.

    Every known cell is a vertex with x, y, z, sigma and state. Triangles join confirmed and filled
    neighbours, counter-clockwise seen from above; not unconfirmed ones: those may be flying pixels.
    """
    rows, columns = np.nonzero(map_.known)
    vertices = np.zeros(rows.size, _VERTEX)
    vertices["x"], vertices["y"] = map_.x_m[columns], map_.y_m[rows]
    for name, layer in (("z", map_.elevation_m), ("sigma", map_.sigma_m), ("state", map_.state)):
        vertices[name] = layer[rows, columns]
    corners = _triangles(map_)
    triangles = np.zeros(len(corners), _TRIANGLE)
    triangles["count"], triangles["corners"] = 3, corners
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {software()}; {FRAME}; x y z sigma in metres; state: {_state_names()}",
        f"element vertex {vertices.size}",
        *(f"property float {name}" for name in ("x", "y", "z", "sigma")),
        "property uchar state",
        f"element face {triangles.size}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    return "\n".join(header).encode("ascii") + vertices.tobytes() + triangles.tobytes()


_VERTEX = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("sigma", "<f4"), ("state", "u1")])
_TRIANGLE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def _triangles(map_: ElevationMap) -> NDArray[np.int64]:
    """Return vertex numbers (n, 3): two triangles per square, one where a corner is missing."""
    number = np.cumsum(map_.known).reshape(map_.state.shape) - 1
    number[~(np.isin(map_.state, _IN_MESH) & map_.known)] = -1
    # Corners of every square, counter-clockwise from the smallest x and y.
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    cut_bd = (a < 0) | (c < 0)  # the diagonal a-c is not there: cut along b-d
    halves = (
        np.where(cut_bd, (a, b, d), (a, b, c)),
        np.where(cut_bd, (b, c, d), (a, c, d)),
    )
    every = np.concatenate([half.reshape(3, -1).T for half in halves])
    return every[(every >= 0).all(axis=1)]


def png(map_: ElevationMap) -> bytes:
    """Return a 16-bit greyscale height map, row 0 = largest y.

    Value 0 is unknown; else height_m = height_offset_m + height_scale_m * value. Both numbers,
    this formula and the place of the picture are in its text chunks.
    """
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    known = map_.elevation_m[map_.known].astype(np.float64)
    low_m, high_m = (known.min(), known.max()) if known.size else (0.0, 0.0)
    scale_m = max((high_m - low_m) / (_PNG_LAST - 1), _PNG_SCALE_MIN_M)
    values = np.zeros(map_.state.shape, np.uint16)
    values[map_.known] = 1 + np.rint((known - low_m) / scale_m)
    text = {
        "Title": "Elevation map",
        "Software": software(),
        "Description": "0 = unknown, else height_m = height_offset_m + height_scale_m * value; "
        "column i: x_m = first_x_m + i * cell_size_m, row j: y_m = first_y_m - j * cell_size_m",
        "frame": FRAME,
        "height_scale_m": repr(float(scale_m)),
        "height_offset_m": repr(float(low_m - scale_m)),
        "cell_size_m": repr(map_.resolution_m),
        "first_x_m": repr(float(map_.x_m[0])),
        "first_y_m": repr(float(map_.y_m[-1])),
        "arrays_sha256": map_.sha256(),
    }
    chunks = PngInfo()
    for name, value in text.items():
        chunks.add_text(name, value)
    buffer = io.BytesIO()
    Image.fromarray(values[::-1]).save(buffer, "PNG", pnginfo=chunks)
    return buffer.getvalue()


def _state_names() -> str:
    return ", ".join(f"{state.value} {state.name.lower()}" for state in CellState)


_FORMATS: dict[str, Callable[[ElevationMap], bytes]] = {
    ".tif": geotiff,
    ".tiff": geotiff,
    ".ply": ply,
    ".png": png,
}
