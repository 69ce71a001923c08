"""Laws of sigma(z, theta), fitted to the cells.

With t = theta / (pi/2 - theta) and parameters p >= 0 (c2 in 0 ... 1 m):

    disparity:   sqrt((p0 + p1 t^2 / sqrt(z))^2 + (p2 z^2)^2)      noise of the disparity is even
    nguyen:      p0 + p1 (z - p2)^2 + p3 t^2 / sqrt(z)             Nguyen et al. 2012
    fankhauser:  p0 + p1 (z - p2)^2 + p3 t^2 / sqrt(z) + p4 z^2 (1 + cos a)
                 Fankhauser et al. 2015: sunlight at angle a to the plate's normal adds d z^2
    khoshelham:  p0 z^2                                            Khoshelham and Elberink 2012
    constant:    p0

All but "disparity" describe a spread that has the steps in it or not, as they are fitted; here it
is the spread without steps, and the step's k is written beside it. A cell whose noise is only
known to be below a bound pulls a law down to that bound and no further.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, radians, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from calibration_rigs.plate_rig.cell_result import CellResult
from mapping.noise import DepthNoiseModel

Float64Array = NDArray[np.float64]
Law = Callable[[Float64Array, "Conditions"], Float64Array]

# No law holds better than this: it keeps a cell with a tiny interval from ruling the fit.
_LAW_SHARE = 0.01
# Where cells hardly tell a parameter, it wanders; the law is as good long before it stops.
_EVALUATIONS = 60


@dataclass(frozen=True, slots=True)
class Conditions:
    """Where a law is asked: distance, angle ratio t and sunlight (1 + cos a, 0 without sun)."""

    z_m: Float64Array
    ratio: Float64Array
    sun: Float64Array


@dataclass(frozen=True, slots=True)
class CellSigmas:
    """The cells' sigmas as a fit needs them: (n,) arrays.

    Attributes:
        at: where.
        sigma_m: sigma, or the bound where `is_below`.
        error: standard deviation of log sigma.
        is_below: sigma is a bound.
        station: number of the station.
    """

    at: Conditions
    sigma_m: Float64Array
    error: Float64Array
    is_below: NDArray[np.bool_]
    station: NDArray[np.int64]

    def some(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> CellSigmas:
        """Return a part of the cells."""
        at = Conditions(self.at.z_m[chosen], self.at.ratio[chosen], self.at.sun[chosen])
        return CellSigmas(
            at,
            self.sigma_m[chosen],
            self.error[chosen],
            self.is_below[chosen],
            self.station[chosen],
        )


@dataclass(frozen=True, slots=True)
class SigmaFit:
    """A law with its parameters.

    Attributes:
        name: which law.
        parameters: as above.
        covariance: of the parameters, from the bootstrap; zeros before it.
        misfit: root mean square of log(cell / law), over cells whose sigma is told.
        held_out: the same for the cells of each station by a fit without that station; infinite
            where too few stations tell sigma.
    """

    name: str
    parameters: Float64Array
    covariance: Float64Array
    misfit: float
    held_out: float

    def sigma_m(self, at: Conditions) -> Float64Array:
        """Return sigma without the steps."""
        sigma: Float64Array = _LAWS[self.name].law(self.parameters, at)
        return sigma

    def as_model(self, quantum_per_m: float) -> DepthNoiseModel:
        """Return the law as the mapper's model, steps included; names and ranges are left."""
        p = [float(value) for value in self.parameters]
        if self.name == "disparity":
            quantum = sqrt(12.0 * p[2] ** 2 + quantum_per_m**2)
            return DepthNoiseModel("", p[0], axial_angle_m_sqrt_m=p[1], quantum_per_m=quantum)
        if self.name == "constant":
            return DepthNoiseModel("", p[0], quantum_per_m=quantum_per_m)
        if self.name == "khoshelham":
            return DepthNoiseModel("", 0.0, p[0], quantum_per_m=quantum_per_m)
        # p1 (z - p2)^2 + s z^2 = (p1 + s) (z - p1 p2 / (p1 + s))^2 + p1 p2^2 s / (p1 + s)
        sun = p[4] if self.name == "fankhauser" else 0.0
        whole = p[1] + sun
        reference = p[1] * p[2] / whole if whole > 0.0 else 0.0
        offset = p[0] + (p[1] * p[2] ** 2 * sun / whole if whole > 0.0 else 0.0)
        return DepthNoiseModel("", offset, whole, reference, p[3], quantum_per_m=quantum_per_m)


@dataclass(frozen=True, slots=True)
class _LawRow:
    law: Law
    start: tuple[float, ...]
    highest: tuple[float, ...]


def _disparity(p: Float64Array, at: Conditions) -> Float64Array:
    axial = p[0] + p[1] * at.ratio**2 / np.sqrt(at.z_m)
    value: Float64Array = np.hypot(axial, p[2] * at.z_m**2)
    return value


def _nguyen(p: Float64Array, at: Conditions) -> Float64Array:
    value: Float64Array = p[0] + p[1] * (at.z_m - p[2]) ** 2 + p[3] * at.ratio**2 / np.sqrt(at.z_m)
    return value


def _fankhauser(p: Float64Array, at: Conditions) -> Float64Array:
    value: Float64Array = _nguyen(p, at) + p[4] * at.sun * at.z_m**2
    return value


def _khoshelham(p: Float64Array, at: Conditions) -> Float64Array:
    value: Float64Array = p[0] * at.z_m**2
    return value


def _constant(p: Float64Array, at: Conditions) -> Float64Array:
    return np.full_like(at.z_m, p[0])


_LAWS = {
    "disparity": _LawRow(_disparity, (1e-3, 1e-4, 1.5e-3), (1.0, 1.0, 1.0)),
    "nguyen": _LawRow(_nguyen, (1e-3, 2e-3, 0.4, 1e-4), (1.0, 1.0, 1.0, 1.0)),
    "fankhauser": _LawRow(_fankhauser, (1e-3, 2e-3, 0.4, 1e-4, 1e-4), (1.0, 1.0, 1.0, 1.0, 1.0)),
    "khoshelham": _LawRow(_khoshelham, (1.4e-3,), (1.0,)),
    "constant": _LawRow(_constant, (5e-3,), (1.0,)),
}


def law_m(name: str, parameters: Float64Array, at: Conditions) -> Float64Array:
    """Return a law's sigma, steps not included, metres."""
    return _LAWS[name].law(parameters, at)


def cell_sigmas(cells: list[CellResult]) -> CellSigmas:
    """Return what the fits need of the cells that are used."""
    theta = np.array([cell.incidence_rad for cell in cells])
    sun = [
        1.0 + cos(radians(cell.cell.sun_angle_deg)) if cell.cell.sun_angle_deg is not None else 0.0
        for cell in cells
    ]
    stations = np.array([cell.cell.distance_m for cell in cells])
    with np.errstate(divide="ignore"):
        error = [
            0.1 if c.spread.is_below else float(np.log(c.spread.high / c.spread.low)) / 3.92
            for c in cells
        ]
    return CellSigmas(
        Conditions(
            np.array([cell.z_m for cell in cells]), theta / (np.pi / 2.0 - theta), np.array(sun)
        ),
        np.array([cell.sigma_m for cell in cells]),
        np.hypot(np.array(error), _LAW_SHARE),
        np.array([cell.spread.is_below for cell in cells]),
        np.unique(stations, return_inverse=True)[1].astype(np.int64),
    )


def fit_laws(cells: CellSigmas) -> list[SigmaFit]:
    """Return every law that the cells can tell, the one that predicts best first.

    "Best" is what predicts a station that it has not seen; the law with fewer parameters wins
    where two are within 5 %.
    """
    names = [
        name
        for name, row in _LAWS.items()
        if len(row.start) <= int(np.count_nonzero(~cells.is_below))
        and (name != "fankhauser" or cells.at.sun.any())
    ]
    fits = [_fitted(name, cells) for name in names]
    # Without a station to leave out, what fits best has to do.
    scores = [fit.held_out if np.isfinite(fit.held_out) else 1.0 + fit.misfit for fit in fits]
    near = 1.05 * min(scores, default=0.0) + 1e-4
    order = sorted(
        range(len(fits)),
        key=lambda k: (scores[k] > near, fits[k].parameters.size, scores[k]),
    )
    return [fits[k] for k in order]


def _fitted(name: str, cells: CellSigmas) -> SigmaFit:
    parameters = fit_parameters(name, cells)
    misfit = _log_ratio(name, parameters, cells)
    held = []
    for station in np.unique(cells.station):
        rest, out = cells.some(cells.station != station), cells.some(cells.station == station)
        told = np.count_nonzero(~rest.is_below) >= parameters.size
        if told and not out.is_below.all():
            held.append(_log_ratio(name, fit_parameters(name, rest), out))
    return SigmaFit(
        name,
        parameters,
        np.zeros((parameters.size, parameters.size)),
        float(np.sqrt(np.mean(misfit**2))) if misfit.size else 0.0,
        float(np.sqrt(np.mean(np.concatenate(held) ** 2))) if held else float("inf"),
    )


def _log_ratio(name: str, parameters: Float64Array, cells: CellSigmas) -> Float64Array:
    told = cells.some(~cells.is_below)
    ratio: Float64Array = np.log(told.sigma_m / _LAWS[name].law(parameters, told.at))
    return ratio


def fit_parameters(name: str, cells: CellSigmas) -> Float64Array:
    """Return a law's parameters by weighted least squares of log sigma."""
    row = _LAWS[name]

    def residuals(p: Float64Array) -> Float64Array:
        """Return (n,) log of law over cell, in sigmas; a bound counts where the law exceeds it."""
        off = np.log(np.maximum(row.law(p, cells.at), 1e-9) / cells.sigma_m)
        return np.where(cells.is_below, np.maximum(off, 0.0), off) / cells.error

    bounds = ([0.0] * len(row.start), list(row.highest))
    found = least_squares(
        residuals, row.start, bounds=bounds, x_scale=np.array(row.start), max_nfev=_EVALUATIONS
    )
    return np.asarray(found.x, np.float64)
