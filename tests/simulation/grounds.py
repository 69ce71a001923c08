"""Grounds that tests drive on."""

from __future__ import annotations

import numpy as np

from simulation.terrain.height_grid import HeightGrid

SPACING_M = 0.02


def sloping(degrees: float = 0.0, half_size_m: float = 4.0) -> HeightGrid:
    """A plane that rises along x."""
    x = SPACING_M * np.arange(round(2 * half_size_m / SPACING_M) + 1) - half_size_m
    heights = np.tile(np.tan(np.radians(degrees)) * x, (x.size, 1))
    return HeightGrid(-half_size_m, -half_size_m, SPACING_M, heights.astype(np.float32))


def bumpy(seed: int = 1, half_size_m: float = 4.0) -> HeightGrid:
    """Forty waves of 0.1 to 2 m in all directions, together about 12 mm rms."""
    random = np.random.default_rng(seed)
    axis = SPACING_M * np.arange(round(2 * half_size_m / SPACING_M) + 1) - half_size_m
    x, y = np.meshgrid(axis, axis)
    heights = np.zeros_like(x)
    for _ in range(40):
        length, direction = np.exp(random.uniform(np.log(0.1), np.log(2.0))), random.uniform(0, 7)
        along = (np.cos(direction) * x + np.sin(direction) * y) / length
        heights += 0.006 * length**0.5 * np.sin(2 * np.pi * along + random.uniform(0, 7))
    return HeightGrid(-half_size_m, -half_size_m, SPACING_M, heights.astype(np.float32))
