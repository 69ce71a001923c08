"""What the update of a cell hands from step to step: numbers, and no arrays."""

from __future__ import annotations

from typing import NamedTuple


class Systematic(NamedTuple):
    """Height change in metres for one sigma of each constant error; see `CellLayers`."""

    a_m: float
    b_m: float
    c_m: float
    bias_m: float


class Measurement(NamedTuple):
    """One frame's word on one cell.

    height_m in T; own_m2: variance from pixel noise and from sampling the surface inside the
    cell; common_m2: from the frame's pose; systematic: see `CellLayers`; relief_m2: spread of the
    surface inside the cell.
    """

    height_m: float
    own_m2: float
    common_m2: float
    systematic: Systematic
    relief_m2: float
    pixels: float


class Sums(NamedTuple):
    """One frame's sums over one cell, and the cell's middle relative to the camera."""

    weight: float
    weight_height: float
    weight_height2: float
    pixels: float
    x_m: float
    y_m: float


class Known(NamedTuple):
    """What the map knows of one cell; see `CellLayers`. since_ns: time since its last update."""

    height_m: float
    variance_m2: float
    systematic: Systematic
    relief_m2: float
    pixels: float
    frames: float
    since_ns: float


class Updated(NamedTuple):
    """A cell after a measurement; `rest` is the share of what was known before."""

    height_m: float
    variance_m2: float
    systematic: Systematic
    relief_m2: float
    rest: float


class UpdateCounts(NamedTuple):
    """What happened to the cells of one frame."""

    cells: int
    rejected: int
    replaced: int
