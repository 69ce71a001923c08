"""Terrain in closed form: mounds, bowls and waves, so that its height is known everywhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]


@njit(cache=True, inline="always", error_model="numpy")
def height_at(bumps: Float64Array, waves: Float64Array, x: float, y: float) -> float:
    """Return the height in metres at (x, y); see `AnalyticTerrain` for the arrays."""
    height = 0.0
    for k in range(bumps.shape[0]):
        dx = x - bumps[k, 0]
        dy = y - bumps[k, 1]
        rest = 1.0 - (dx * dx + dy * dy) / (bumps[k, 3] * bumps[k, 3])
        if rest > 0.0:
            height += bumps[k, 2] * rest * rest * rest
    for k in range(waves.shape[0]):
        height += waves[k, 2] * np.sin(waves[k, 0] * x + waves[k, 1] * y + waves[k, 3])
    return height


@njit(cache=True, error_model="numpy")
def _fill_heights(
    bumps: Float64Array, waves: Float64Array, x: Float64Array, y: Float64Array, out: Float64Array
) -> None:
    for i in range(x.shape[0]):
        out[i] = height_at(bumps, waves, x[i], y[i])


@dataclass(frozen=True, slots=True)
class AnalyticTerrain:
    """A sum of bumps h (1 - r^2 / R^2)^3 within r < R, and of plane waves; twice differentiable.

    Attributes:
        bumps: (K, 4) rows of x, y, height h (negative = hollow) and radius R, metres.
        waves: (M, 4) rows of wave number in x and y (rad/m), amplitude (m) and phase (rad).
    """

    bumps: Float64Array
    waves: Float64Array

    def height_m(self, x_m: Float64Array, y_m: Float64Array) -> Float64Array:
        """Return heights for coordinates of any equal shape."""
        x, y = np.broadcast_arrays(np.asarray(x_m, float), np.asarray(y_m, float))
        out = np.empty(x.size)
        _fill_heights(self.bumps, self.waves, x.ravel(), y.ravel(), out)
        return out.reshape(x.shape)


def crater_field(seed: int, length_m: float, width_m: float) -> AnalyticTerrain:
    """Return gently rolling ground with hollows, their rims and a few mounds.

    The ground spans x in [-1, length], y in [-width/2, width/2]. Hollows are 0.5-1.2 m across and
    0.1 of that deep with a rim of a fifth of their depth, about what fresh small lunar craters
    show; mounds are up to 12 cm high.

    Args:
        seed: same seed, same terrain.
        length_m: extent along x.
        width_m: extent along y.
    """
    random = np.random.default_rng(seed)
    bumps: list[tuple[float, float, float, float]] = []
    for _ in range(5):
        x, y = random.uniform(0.5, length_m), random.uniform(-0.5, 0.5) * width_m
        radius = random.uniform(0.25, 0.6)
        depth = 0.2 * radius
        bumps += [(x, y, 0.4 * depth, 1.7 * radius), (x, y, -1.4 * depth, 1.1 * radius)]
    for _ in range(4):
        x, y = random.uniform(1.0, length_m), random.uniform(-0.5, 0.5) * width_m
        bumps.append((x, y, random.uniform(0.04, 0.12), random.uniform(0.3, 0.7)))
    waves = [
        (random.uniform(-2.5, 2.5), random.uniform(-2.5, 2.5), 0.02, random.uniform(0, 2 * np.pi))
        for _ in range(3)
    ]
    return AnalyticTerrain(np.array(bumps), np.array(waves))
