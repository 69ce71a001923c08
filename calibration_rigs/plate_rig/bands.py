"""How well a law of sigma(z, theta) predicts: bands and covariance by bootstrap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from calibration_rigs.plate_rig.sigma_models import (
    CellSigmas,
    Conditions,
    SigmaFit,
    fit_parameters,
    law_m,
)

Float64Array = NDArray[np.float64]

BOOTSTRAPS = 200


@dataclass(frozen=True, slots=True)
class Bands:
    """The law and its 95 % bands over distance, at some angles.

    Attributes:
        z_m: (n,) distances.
        angles_rad: (k,) angles.
        sigma_m, low_m, high_m: (k, n).
    """

    z_m: Float64Array
    angles_rad: Float64Array
    sigma_m: Float64Array
    low_m: Float64Array
    high_m: Float64Array


def bootstrap(
    fit: SigmaFit,
    cells: CellSigmas,
    z_m: Float64Array,
    angles_rad: Float64Array,
    draws: int = BOOTSTRAPS,
) -> tuple[SigmaFit, Bands]:
    """Return the fit with its covariance, and its prediction bands.

    Cells are drawn with replacement station by station, so that what one station shares moves
    together, and moved within their own intervals. Bands tell what the parameters cannot: these
    trade against each other.
    """
    random = np.random.default_rng(1)
    grid = _grid(z_m, angles_rad)
    stations = np.unique(cells.station)
    members = [np.flatnonzero(cells.station == station) for station in stations]
    found = []
    for _ in range(draws):
        chosen = np.concatenate(
            [members[k] for k in random.integers(0, len(members), len(members))]
        )
        some = cells.some(chosen)
        noise = np.exp(some.error * random.standard_normal(chosen.size))
        moved = np.where(some.is_below, some.sigma_m, some.sigma_m * noise)
        found.append(
            fit_parameters(
                fit.name, CellSigmas(some.at, moved, some.error, some.is_below, some.station)
            )
        )
    parameters = np.array(found)
    shape = (angles_rad.size, z_m.size)
    spread = np.array([law_m(fit.name, p, grid) for p in parameters])
    spread *= np.exp(fit.misfit * random.standard_normal((len(spread), 1)))
    low, high = np.quantile(spread, norm.cdf([-1.96, 1.96]), axis=0)
    covariance = np.atleast_2d(np.cov(parameters.T))
    sure = SigmaFit(fit.name, fit.parameters, covariance, fit.misfit, fit.held_out)
    return sure, Bands(
        z_m, angles_rad, fit.sigma_m(grid).reshape(shape), low.reshape(shape), high.reshape(shape)
    )


def _grid(z_m: Float64Array, angles_rad: Float64Array) -> Conditions:
    angle, z = (axis.ravel() for axis in np.meshgrid(angles_rad, z_m, indexing="ij"))
    return Conditions(z, angle / (np.pi / 2.0 - angle), np.zeros_like(z))
