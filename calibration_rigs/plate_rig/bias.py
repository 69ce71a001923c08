"""How far readings are off on average: bias(Z) = b0 + b1 Z + b2 Z^2, and how well it is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration_rigs.errors import RigError
from calibration_rigs.plate_rig.cell_result import CellResult
from calibration_rigs.plate_rig.manifest import Rig

Float64Array = NDArray[np.float64]

# Beyond this a cell is no outlier of the sensor but of the tape.
_TAPE_M = 0.05


@dataclass(frozen=True, slots=True)
class BiasFit:
    """The fit.

    Attributes:
        coefficients: (b0, b1, b2); those that the stations cannot tell are 0.
        covariance: (3, 3), without the tape's zero.
        scatter: root of chi-square per degree of freedom; the covariance has it in, if above 1.
        held_out_m: root mean square error at a station by the fit without it; 0 when there are
            too few stations to leave one out.
        zero_sigma_m: what all readings of the tape share.
    """

    coefficients: Float64Array
    covariance: Float64Array
    scatter: float
    held_out_m: float
    zero_sigma_m: float

    def at_m(self, z_m: Float64Array) -> Float64Array:
        """Return reading minus truth."""
        bias: Float64Array = _powers(z_m) @ self.coefficients
        return bias

    def sigma_m(self, z_m: Float64Array) -> Float64Array:
        """Return the standard deviation of the bias that is left after correction."""
        powers = _powers(z_m)
        variance = np.einsum("ni,ij,nj->n", powers, self.covariance, powers)
        sigma: Float64Array = np.sqrt(variance + self.zero_sigma_m**2)
        return sigma

    def as_line(self, z_m: Float64Array) -> tuple[float, float]:
        """Return s0, s2 with s0 + s2 z^2 not below `sigma_m` at the distances."""
        sigma = self.sigma_m(z_m)
        s0 = float(min(self.zero_sigma_m, sigma.min()))
        return s0, float(np.max((sigma - s0) / z_m**2))


def fit_bias(cells: list[CellResult], rig: Rig) -> BiasFit:
    """Return the bias by weighted least squares over the cells with tape.

    Raises:
        RigError: no cell has one.
    """
    taped = [cell for cell in cells if cell.error_m is not None]
    if not taped:
        raise RigError("no cell has a tape reading that can be used; measure the distances")
    z, error, sigma = (
        np.array(values, np.float64)
        for values in zip(
            *((cell.z_m, cell.error_m, cell.error_sigma_m) for cell in taped), strict=True
        )
    )
    station = np.array([cell.cell.distance_m for cell in taped])
    terms = min(3, np.unique(station).size)
    coefficients, covariance, scatter = _weighted(z, error, sigma, terms)
    held = []
    for one in np.unique(station) if np.unique(station).size > terms else ():
        rest = station != one
        without, _, _ = _weighted(z[rest], error[rest], sigma[rest], terms)
        off = error[~rest] - _powers(z[~rest]) @ without
        held.append(np.average(off, weights=sigma[~rest] ** -2))
    held_out = float(np.sqrt(np.mean(np.square(held)))) if held else 0.0
    return BiasFit(coefficients, covariance, scatter, held_out, rig.tape_zero_sigma_m)


def tape_outliers(cells: list[CellResult]) -> list[int]:
    """Return the cells whose tape is off by decimetres: by the others' bias, robustly."""
    taped = [k for k, cell in enumerate(cells) if cell.error_m is not None]
    if len(taped) < 4:
        return []
    z = np.array([cells[k].z_m for k in taped])
    error = np.array([cells[k].error_m for k in taped], np.float64)
    relative = error / z**2  # of a disparity sensor this is constant
    off = np.abs(relative - np.median(relative)) * z**2
    sigma = np.array([cells[k].error_sigma_m for k in taped])
    return [taped[k] for k in np.flatnonzero(off > _TAPE_M + 5.0 * sigma)]


def _powers(z_m: Float64Array) -> Float64Array:
    return np.stack([np.ones_like(z_m), z_m, z_m**2], axis=-1)


def _weighted(
    z: Float64Array, error: Float64Array, sigma: Float64Array, terms: int
) -> tuple[Float64Array, Float64Array, float]:
    """Return coefficients, covariance and scatter; one term is the constant, two add z^2."""
    used = {1: [0], 2: [0, 2], 3: [0, 1, 2]}[terms]
    columns = _powers(z)[:, used] / sigma[:, np.newaxis]
    solution = np.linalg.lstsq(columns, error / sigma, rcond=None)[0]
    degrees = max(z.size - len(used), 1)
    left = error / sigma - columns @ solution
    scatter = float(np.sqrt(left @ left / degrees))
    coefficients, covariance = np.zeros(3), np.zeros((3, 3))
    coefficients[used] = solution
    inverse = np.linalg.pinv(columns.T @ columns)
    covariance[np.ix_(used, used)] = inverse * max(scatter, 1.0) ** 2
    return coefficients, covariance, scatter
