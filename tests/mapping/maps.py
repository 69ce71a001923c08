"""Small elevation maps for tests."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
from numpy.typing import ArrayLike

from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.settings import MapSettings

# A stamp whose last digits a floating number would lose.
EPOCH_NS = 1_700_000_000_123_456_789
_PLAIN_SETTINGS = {
    name: value for name, value in asdict(MapSettings()).items() if not isinstance(value, tuple)
}


def make_map(
    elevation_m: ArrayLike,
    sigma_m: ArrayLike = 0.01,
    state: ArrayLike | None = None,
    resolution_m: float = 0.04,
    first_x: int = -3,
    first_y: int = 5,
) -> ElevationMap:
    """Return a map of these heights (rows = y); NaN = unknown, others "measured" unless stated.

    `first_x`, `first_y` number the first column and row over the terrain frame.
    """
    elevation = np.asarray(elevation_m, np.float32)
    rows, columns = elevation.shape
    known = np.isfinite(elevation)
    if state is None:
        state = np.where(known, CellState.MEASURED, CellState.UNKNOWN)
    variance = np.broadcast_to(np.square(np.asarray(sigma_m, np.float64)), elevation.shape)
    variance = np.where(known, variance, np.nan).astype(np.float32)
    return ElevationMap(
        resolution_m=resolution_m,
        x_m=(np.arange(first_x, first_x + columns) + 0.5) * resolution_m,
        y_m=(np.arange(first_y, first_y + rows) + 0.5) * resolution_m,
        elevation_m=elevation,
        variance_m2=variance,
        independent_m2=np.float32(0.25) * variance,
        systematic_m2=np.float32(0.5) * variance,
        relief_m2=np.float32(0.25) * variance,
        frames=np.where(known, 7, 0).astype(np.uint32),
        pixels=np.where(known, 90, 0).astype(np.uint32),
        last_seen_ns=np.where(known, EPOCH_NS, 0).astype(np.int64),
        state=np.broadcast_to(np.asarray(state, np.uint8), elevation.shape).copy(),
        attributes={**_PLAIN_SETTINGS, "noise_model": "nguyen2012", "frames": 58},
    )


def hilly_map(rows: int = 30, columns: int = 40, seed: int = 1) -> ElevationMap:
    """Return hills with unknown, unconfirmed, measured and uncertain cells."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[0:rows, 0:columns] * 0.04
    elevation = 0.1 * np.sin(3.0 * x) * np.cos(4.0 * y) + 0.05 * x
    elevation[random.random(elevation.shape) < 0.1] = np.nan
    sigma = 0.002 + 0.02 * random.random(elevation.shape) ** 2
    state = np.where(sigma < 0.015, CellState.MEASURED, CellState.UNCERTAIN)
    state[random.random(elevation.shape) < 0.05] = CellState.UNCONFIRMED
    state[np.isnan(elevation)] = CellState.UNKNOWN
    return make_map(elevation, sigma, state)
