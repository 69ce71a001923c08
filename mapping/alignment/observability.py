"""Which directions of a pose the points fix, and how well."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapping.alignment.plane_problem import NormalEquations
from mapping.alignment.settings import AlignmentSettings

Float64Array = NDArray[np.float64]

# Variance, in m^2, along directions that nothing fixes: far above that of any prior, and far
# below what would drown the others in rounding.
UNKNOWN_M2 = 1e6
# Entries of (x, y, z, rotation about x, y, z) that each form may move.
_MOVED = {"6-dof": [0, 1, 2, 3, 4, 5], "z-roll-pitch": [2, 3, 4]}


def metres_per_unit(settings: AlignmentSettings) -> Float64Array:
    """Return (6,): metres per unit of (x, y, z, rotations); rotations count at the lever."""
    return np.array([1.0, 1.0, 1.0, *[settings.lever_m] * 3])


def observable_directions(
    information: Float64Array, points: int, settings: AlignmentSettings
) -> Float64Array:
    """Return (6, k): orthonormal directions, in metres, that the points fix well enough.

    Args:
        information: (6, 6) J' w J over (shift, rotation), without what noise adds to it; it
            counts `cells_per_independent` times less.
        points: number of points in it.
        settings: of the alignment.
    """
    if points < settings.fewest_points:
        return np.zeros((6, 0))
    moved = _MOVED[settings.form]
    unit = metres_per_unit(settings)[moved]
    values, vectors = np.linalg.eigh(information[np.ix_(moved, moved)] / np.outer(unit, unit))
    fixed = values / settings.cells_per_independent >= settings.observable_m**-2
    directions = np.zeros((6, int(fixed.sum())))
    directions[moved] = vectors[:, fixed]
    return directions


def covariance(
    sums: NormalEquations, directions: Float64Array, settings: AlignmentSettings
) -> Float64Array:
    """Return (6, 6) of (shift, rotation): inverse information and floors, elsewhere unknown.

    The floors stand for what no residual shows: errors that map and frame share. Scraps of ground
    must not hold the rover against everything else, so they grow where there are few points.
    """
    unit = metres_per_unit(settings)
    along = directions / unit[:, np.newaxis]
    scale = settings.cells_per_independent * max(sums.sigma_scale, 1.0) ** 2
    fixed = directions @ np.linalg.inv(along.T @ sums.normal @ along) @ directions.T * scale
    unknown = UNKNOWN_M2 * (np.eye(6) - directions @ directions.T)
    scraps = max(settings.full_points / max(sums.points, 1), 1.0) ** 2
    floors = scraps * np.diag([settings.floor_m**2] * 3 + [settings.floor_rad**2] * 3)
    return (fixed + unknown) / np.outer(unit, unit) + floors
