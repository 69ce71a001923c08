"""What is stored of every cell of a map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
CellIndex = tuple[slice, slice] | tuple[NDArray[np.intp], ...]


class CellLayers(NamedTuple):
    """What is known of every cell; all arrays (rows, columns).

    elevation_m: height in T. variance_m2: variance of all errors that differ from frame to frame.
    systematic_*_m: how far one sigma of each error that stays the same for the whole run moves
    the cell: mount rotation about the sensor's x, y and z, and depth bias. relief_m2: spread of
    the surface inside the cell, in excess of pixel noise: unbiased, so it may be below 0 where the
    ground is flat. candidate_*: the second hypothesis, the variance of its pixel noise, and how
    often it was confirmed. frames, pixels: accepted measurements and the pixels in them, which
    stop counting at 2^32 - 1. last_ns: stamp of the last one, meaningless while frames is 0.
    seen_through: frames whose rays passed through the cell, less those with a reading in it.
    hidden: 1 where something nearer hid the cell from a view of it; of interest until it is seen.

    Heights are float64: far above the origin the small steps of late updates would vanish in
    float32, whose steps are 1 mm at 10 km.
    """

    elevation_m: Float64Array
    variance_m2: Float32Array
    systematic_a_m: Float32Array
    systematic_b_m: Float32Array
    systematic_c_m: Float32Array
    systematic_bias_m: Float32Array
    relief_m2: Float32Array
    candidate_m: Float64Array
    candidate_m2: Float32Array
    candidate_hits: NDArray[np.uint8]
    frames: NDArray[np.uint32]
    pixels: NDArray[np.uint32]
    last_ns: NDArray[np.int64]
    seen_through: NDArray[np.uint8]
    hidden: NDArray[np.uint8]


def empty_layers(rows: int, columns: int) -> CellLayers:
    """Return layers of cells that nobody has seen."""
    shape = (rows, columns)
    return CellLayers(
        elevation_m=np.zeros(shape, np.float64),
        variance_m2=np.zeros(shape, np.float32),
        systematic_a_m=np.zeros(shape, np.float32),
        systematic_b_m=np.zeros(shape, np.float32),
        systematic_c_m=np.zeros(shape, np.float32),
        systematic_bias_m=np.zeros(shape, np.float32),
        relief_m2=np.zeros(shape, np.float32),
        candidate_m=np.zeros(shape, np.float64),
        candidate_m2=np.zeros(shape, np.float32),
        candidate_hits=np.zeros(shape, np.uint8),
        frames=np.zeros(shape, np.uint32),
        pixels=np.zeros(shape, np.uint32),
        last_ns=np.zeros(shape, np.int64),
        seen_through=np.zeros(shape, np.uint8),
        hidden=np.zeros(shape, np.uint8),
    )


def copy_cells(source: CellLayers, there: CellIndex, target: CellLayers, here: CellIndex) -> None:
    """Copy the cells at `there` in the source to `here` in the target, in all layers."""
    for name, layer in source._asdict().items():
        getattr(target, name)[here] = layer[there]


BYTES_PER_CELL = sum(layer.itemsize for layer in empty_layers(0, 0))
