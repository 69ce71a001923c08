"""The map that is handed out: heights, their variance and its parts, and the state of each cell."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from mapping.cells.cell_layers import CellLayers
from mapping.cells.grid import Cells
from mapping.cells.part_kernels import PartConstants, Parts, combine, noise_of_heights, slopes
from mapping.cells.relief_kernels import surrounding_relief
from mapping.errors import MappingError
from mapping.motion.read_out import Rover, place_errors, standing
from mapping.motion.read_out_kernels import PlaceErrors
from mapping.settings import MapSettings

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]

# The exponent's bits of a float32.
_EXPONENT = np.int32(0x7F800000)


class CellState(IntEnum):
    """What is known of a cell."""

    UNKNOWN = 0  # never seen
    UNCONFIRMED = 1  # seen in too few frames or pixels: may be a flying pixel
    MEASURED = 2  # confirmed, and known better than MapSettings.uncertain_sigma_m
    UNCERTAIN = 3  # confirmed, but known no better than that
    FILLED = 4  # never seen: a guess between the rims of a gap, see mapping.ground.fill
    OCCLUDED = 5  # never seen, hidden behind something nearer; a height is a guess as of FILLED


@dataclass(frozen=True, slots=True)
class ElevationMap:
    """A rectangle of cells in the terrain frame (z up); all layers (len(y_m), len(x_m)).

    Attributes:
        resolution_m: edge of a cell.
        x_m, y_m: cell centres, increasing.
        elevation_m: height, NaN where unknown.
        variance_m2: variance of that height: the sum of the five parts below; NaN where unknown.
        independent_m2: part that differs from frame to frame (pixel noise, pose).
        systematic_m2: part that is the same all through the run (depth bias, mount).
        relief_m2: part from the shape of the surface inside the cell.
        pose_m2: part from the height and tilt of the poses, relative to the rover's last place;
            0 for absolute poses, see `mapping.motion.pose_errors`.
        horizontal_m2: part that the slope makes of the errors of the cell's place that came with
            motion; 0 for absolute poses.
        horizontal_xx_m2, horizontal_xy_m2, horizontal_yy_m2: covariance of the cell's place, from
            the start and from motion.
        frames, pixels: frames that contributed, and pixels in them.
        last_seen_ns: stamp of the last contribution, 0 where unknown.
        state: `CellState`.
        attributes: how the map was made (settings, noise model, input, damage), as text or number.
    """

    resolution_m: float
    x_m: Float64Array
    y_m: Float64Array
    elevation_m: Float32Array
    variance_m2: Float32Array
    independent_m2: Float32Array
    systematic_m2: Float32Array
    relief_m2: Float32Array
    pose_m2: Float32Array
    horizontal_m2: Float32Array
    horizontal_xx_m2: Float32Array
    horizontal_xy_m2: Float32Array
    horizontal_yy_m2: Float32Array
    frames: NDArray[np.uint32]
    pixels: NDArray[np.uint32]
    last_seen_ns: NDArray[np.int64]
    state: NDArray[np.uint8]
    attributes: Mapping[str, str | int | float] = field(default_factory=dict)

    @property
    def sigma_m(self) -> Float32Array:
        """Standard deviation of the height."""
        return np.sqrt(self.variance_m2)

    @property
    def lower_m(self) -> Float32Array:
        """Height minus 3 sigma."""
        return self.elevation_m - np.float32(3.0) * self.sigma_m

    @property
    def upper_m(self) -> Float32Array:
        """Height plus 3 sigma."""
        return self.elevation_m + np.float32(3.0) * self.sigma_m

    @property
    def known(self) -> NDArray[np.bool_]:
        """Cells that have a height."""
        known: NDArray[np.bool_] = np.isfinite(self.elevation_m)
        return known

    def sha256(self) -> str:
        """Return the SHA-256 of all arrays: equal maps, to the bit, have equal sums."""
        digest = hashlib.sha256()
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                digest.update(f"{item.name}:{value.dtype.str}:{value.shape};".encode())
                digest.update(np.ascontiguousarray(value).tobytes())
        return digest.hexdigest()


def read_out(
    grid: Cells,
    settings: MapSettings,
    attributes: Mapping[str, str | int | float],
    rover: Rover | None = None,
) -> ElevationMap:
    """Return the map that a grid holds, cut to the cells that were seen.

    Variance = what differs from frame to frame + |sensitivities to the constant errors|^2 +
    mount_sigma_m^2 + relief + what poses and motions of the `rover` add (nothing when left out; see
    `mapping.motion.pose_errors`). Relief is relief_share * spread inside the cell +
    (relief_share + min(1, 3 |slope|^2)) * |slope|^2 d^2 / 12 + spread beyond (d / 2)^2 +
    (min(2, relief_share + relief_frames / frames + (frames / pixels)^2) + min(2, g^2 / 2)) *
    (variance around a plane in 5 x 5 cells), where g^2 is the sum over x and y of
    (q - p)^2 / (4 (p + 1) (q + 1)), p and q the pixels of the neighbours on the two sides.
    The slope term is spread that one view does not show: a far image row crosses a cell along one
    line, and of a steep cell one side is in view and another is not. The next one is what stands up
    in the cell, which then has no single height: its bounds hold the top of a thin post. The last
    one is the ground that few views have sampled here and there in the cell, or that is its
    neighbours': noise has carried readings over the border, most of them to where few belong and
    from where many do.
    Rounding the height to float32 counts as noise that differs from frame to frame; it matters some
    kilometres above the origin of the terrain frame (0.3 mm at 10 km).

    Raises:
        MappingError: the grid has seen nothing.
    """
    layers, first_x, first_y = _cut_to_seen(grid)
    seen = layers.frames > 0
    few = (layers.frames < settings.confirmed_frames) | (layers.pixels < settings.confirmed_pixels)
    x_m = _centres_m(first_x, seen.shape[1], settings.resolution_m)
    y_m = _centres_m(first_y, seen.shape[0], settings.resolution_m)
    moved = place_errors(layers, x_m, y_m, rover or standing())
    parts = _parts(layers, ~few, moved, settings)
    return ElevationMap(
        resolution_m=settings.resolution_m,
        x_m=x_m,
        y_m=y_m,
        **parts._asdict(),
        frames=layers.frames,
        pixels=layers.pixels,
        last_seen_ns=np.where(seen, layers.last_ns, 0),
        attributes=attributes,
    )


def _parts(
    layers: CellLayers, confirmed: NDArray[np.bool_], moved: PlaceErrors, settings: MapSettings
) -> Parts:
    """Return heights, the parts of their variance, places and states."""
    shape = confirmed.shape
    own = [np.empty(shape, np.float32) for _ in Parts._fields[1:-1]]
    heights = layers.elevation_m.astype(np.float32)
    out = Parts._make([heights, *own, np.empty(shape, np.uint8)])
    slope_y, slope_x, around = (np.empty(shape, np.float32) for _ in range(3))
    slopes(layers.elevation_m, confirmed, settings.resolution_m, slope_y, slope_x)
    exponents = (heights.view(np.int32) & _EXPONENT).view(np.float32)
    noise_of_heights(exponents, layers.variance_m2, moved.height_m2, out.independent_m2)
    surrounding_relief(layers.elevation_m, out.independent_m2, confirmed, around)
    constants = PartConstants(
        edge2_m2=settings.resolution_m**2,
        start_m2=settings.horizontal_share * settings.resolution_m**2,
        mount_m2=settings.mount_sigma_m**2,
        relief_share=settings.relief_share,
        relief_frames=settings.relief_frames,
        uncertain_m2=settings.uncertain_sigma_m**2,
        unknown=int(CellState.UNKNOWN),
        unconfirmed=int(CellState.UNCONFIRMED),
        measured=int(CellState.MEASURED),
        uncertain=int(CellState.UNCERTAIN),
        occluded=int(CellState.OCCLUDED),
    )
    combine(layers, confirmed, moved, slope_y, slope_x, around, constants, out)
    return out


def _cut_to_seen(grid: Cells) -> tuple[CellLayers, int, int]:
    """Return copies of the layers inside the box of seen cells, and its first column and row."""
    layers = grid.unrolled()
    seen = layers.frames > 0
    if not seen.any():
        raise MappingError(
            "no depth reading reached the map; check the range limits and that depth frames and "
            "poses overlap in time"
        )
    rows = np.flatnonzero(seen.any(axis=1))
    columns = np.flatnonzero(seen.any(axis=0))
    box = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    cut = CellLayers._make(np.ascontiguousarray(layer[box]) for layer in layers)
    return cut, grid.extent.first_x + int(columns[0]), grid.extent.first_y + int(rows[0])


def _centres_m(first: int, count: int, cell_size_m: float) -> Float64Array:
    return (np.arange(first, first + count, dtype=np.float64) + 0.5) * cell_size_m
