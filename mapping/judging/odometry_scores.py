"""The numbers of a trajectory against the true one, for people and for programs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mapping.geometry import Float64Array
from mapping.judging.accuracy import Json, finite_or_none
from mapping.judging.trajectory import Int64Array

Alignment = Literal["none", "start", "yaw", "se3"]


@dataclass(frozen=True, slots=True)
class Spread:
    """Errors in a few numbers; NaN without any."""

    rmse: float
    median: float
    largest: float
    count: int

    @classmethod
    def of(cls, errors: Float64Array) -> Spread:
        """Return the numbers of (N,) errors."""
        if not errors.size:
            return cls(math.nan, math.nan, math.nan, 0)
        rmse = float(np.sqrt((errors**2).mean()))
        return cls(rmse, float(np.median(errors)), float(errors.max()), errors.size)

    def as_json(self) -> Json:
        """Return the numbers by name; those that are not finite as None."""
        return {
            "rmse": finite_or_none(self.rmse),
            "median": finite_or_none(self.median),
            "max": finite_or_none(self.largest),
            "count": self.count,
        }


@dataclass(frozen=True, slots=True)
class Nees:
    """Whether the covariance is believable.

    Attributes:
        per_dof: mean NEES over its degrees of freedom; 1 is honest, more is too sure of itself.
        inside_95: share of the poses within the 95 % bound of chi-square.
        low, high: 95 % bounds of `per_dof` if the poses of one run had one common error.
    """

    per_dof: float
    inside_95: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class OdometryScores:
    """The comparison.

    Attributes:
        estimate, truth: where the trajectories come from.
        alignment: of the ATE.
        poses: compared.
        seconds, metres: length of the true trajectory between the first and last of them.
        ate_m, ate_horizontal_m, ate_yaw_deg: after the alignment.
        per_metre_m, per_metre_deg, per_second_m, per_second_deg: RPE.
        nees: None without covariances.
        t_ns, error, sigma: for figures: (N,) times; (N, 4) error of x, y, z (m) and yaw (rad) when
            both start together, and its sigma (NaN without covariances).
        nees_values: (N,) NEES over its degrees of freedom.
        estimated_m, true_m: (N, 3) positions after the alignment.
    """

    estimate: str
    truth: str
    alignment: Alignment
    poses: int
    seconds: float
    metres: float
    ate_m: Spread
    ate_horizontal_m: Spread
    ate_yaw_deg: Spread
    per_metre_m: Spread
    per_metre_deg: Spread
    per_second_m: Spread
    per_second_deg: Spread
    nees: Nees | None
    t_ns: Int64Array
    error: Float64Array
    sigma: Float64Array
    nees_values: Float64Array
    estimated_m: Float64Array
    true_m: Float64Array

    def as_json(self) -> Json:
        """Return the numbers by name."""
        names = ["ate_m", "ate_horizontal_m", "ate_yaw_deg"]
        names += ["per_metre_m", "per_metre_deg", "per_second_m", "per_second_deg"]
        return {
            "alignment": self.alignment,
            "poses": self.poses,
            "seconds": self.seconds,
            "metres": self.metres,
            **{name: getattr(self, name).as_json() for name in names},
            "nees_per_dof": finite_or_none(self.nees.per_dof) if self.nees else None,
            "nees_inside_95": finite_or_none(self.nees.inside_95) if self.nees else None,
        }

    def describe(self) -> list[str]:
        """Return lines for people."""
        rows = {
            f"ATE m ({self.alignment})": self.ate_m,
            "  horizontal m": self.ate_horizontal_m,
            "  yaw deg": self.ate_yaw_deg,
            "RPE per metre, m": self.per_metre_m,
            "RPE per metre, deg": self.per_metre_deg,
            "RPE per second, m": self.per_second_m,
            "RPE per second, deg": self.per_second_deg,
        }
        length = f"{self.poses} poses, {self.seconds:.1f} s, {self.metres:.2f} m"
        lines = [
            f"{self.estimate} against {self.truth}: {length}",
            f"{'':<22}{'RMSE':>9}{'median':>9}{'max':>9}{'count':>7}",
        ]
        for name, s in rows.items():
            lines.append(f"{name:<22}{s.rmse:>9.4f}{s.median:>9.4f}{s.largest:>9.4f}{s.count:>7}")
        if self.nees is None:
            return [*lines, "NEES: the estimate has no covariance; write it as .nc"]
        n = self.nees
        lines.append(
            f"NEES/dof of x, y, z, yaw {n.per_dof:.2f} (95 % of single runs: {n.low:.2f} to "
            f"{n.high:.2f}); {100 * n.inside_95:.1f} % of the poses within the 95 % bound"
        )
        return lines
