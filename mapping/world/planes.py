"""All layers of a block of cells as one array of float64, and back to the bit.

A tile must be replaced as a whole, or a crash leaves new heights beside old variances. One array
with a plane for every layer makes a tile one chunk, which is one file. Numbers of up to 32 bits
and float64 keep every bit in a float64; 64-bit integers are split into two planes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapping.cells.cell_layers import CellLayers, empty_layers

Float64Array = NDArray[np.float64]

_HIGH, _LOW = ":high", ":low"
_LOW_BITS = 32


def plane_names() -> tuple[str, ...]:
    """Return what each plane holds: a layer, or 2^32 "layer:high" + "layer:low" = layer."""
    names: list[str] = []
    for name, layer in empty_layers(0, 0)._asdict().items():
        names += [name + _HIGH, name + _LOW] if _is_split(layer.dtype) else [name]
    return tuple(names)


def to_planes(layers: CellLayers) -> Float64Array:
    """Return (planes, rows, columns)."""
    planes: list[NDArray[Any]] = []
    for layer in layers._asdict().values():
        if _is_split(layer.dtype):
            high = layer >> _LOW_BITS
            planes += [high, layer - (high << _LOW_BITS)]
        else:
            planes.append(layer)
    return np.stack([plane.astype(np.float64) for plane in planes])


def from_planes(planes: Float64Array) -> CellLayers:
    """Return the layers of `to_planes`."""
    layers = empty_layers(*planes.shape[1:])
    rest = iter(planes)
    for layer in layers:
        if _is_split(layer.dtype):
            high, low = next(rest), next(rest)
            layer[:] = (high.astype(layer.dtype) << _LOW_BITS) + low.astype(layer.dtype)
        else:
            layer[:] = next(rest)
    return layers


def _is_split(dtype: np.dtype[np.generic]) -> bool:
    return dtype.kind in "iu" and dtype.itemsize > 4
