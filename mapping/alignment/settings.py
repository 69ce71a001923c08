"""How scans are aligned with the map: every number with its unit in its name."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from mapping.errors import MappingError

AlignmentForm = Literal["6-dof", "z-roll-pitch"]

_POSITIVE = (
    "floor_m",
    "floor_rad",
    "prior_sigma_m",
    "prior_sigma_rad",
    "observable_m",
    "cut_m",
    "farthest_m",
    "worst_scale",
    "robust_sigma",
    "lever_m",
    "cells_per_independent",
)
_COUNTS = ("most_misfits", "full_points", "fewest_pixels", "fewest_points", "iterations")


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """Settings of the alignment.

    Attributes:
        form: "6-dof", or "z-roll-pitch", which leaves x, y and yaw alone.
        floor_m, floor_rad: an alignment is never believed to be better than this, per frame of
            `full_points` points; with fewer the floors grow in proportion.
        prior_sigma_m, prior_sigma_rad: what a prior of the rover's own is worth against the map, on
            top of what it claims, along the directions that the points fix: its filter takes one
            alignment after another as independent, and they share the map's errors.
        full_points: number of points (cells seen) that a frame needs to be believed so far; a
            view full of ground has 2000 to 3500 of 4 cm.
        observable_m: directions in which the points fix the pose no better than this (a rotation
            times `lever_m`) keep the prior.
        lever_m: distance at which rotations are compared with shifts.
        cells_per_independent: so many cells count as one independent residual: neighbours share
            the planes of the map and its errors.
        cut_m: residuals beyond are left out.
        farthest_m: a pose that is moved further (rotations times `lever_m`) is not believed.
        worst_scale: nor is one whose residuals spread so many times wider than they should.
        most_misfits: so many frames in a row that fit the map nowhere are left out; the rover is
            then taken to be where the prior says, and the ground to have changed.
        robust_sigma: residuals of so many sigma (of the frame's own spread) weigh half.
        fewest_pixels: cells of map or frame with fewer pixels do not count.
        fewest_points: fewer points than this align nothing.
        iterations: Gauss-Newton steps at most.
    """

    form: AlignmentForm = "6-dof"
    floor_m: float = 0.001
    floor_rad: float = math.radians(0.1)
    prior_sigma_m: float = 0.01
    prior_sigma_rad: float = math.radians(1.0)
    full_points: int = 700
    observable_m: float = 0.006
    lever_m: float = 1.5
    cells_per_independent: float = 10.0
    cut_m: float = 0.15
    farthest_m: float = 0.25
    worst_scale: float = 2.0
    most_misfits: int = 10
    robust_sigma: float = 2.0
    fewest_pixels: int = 3
    fewest_points: int = 100
    iterations: int = 12

    def __post_init__(self) -> None:
        """Refuse values that nothing can be aligned with."""
        for name in _POSITIVE:
            if not 0.0 < getattr(self, name) < math.inf:
                raise MappingError(f"{name} is {getattr(self, name)}; expected a number above 0")
        for name in _COUNTS:
            if getattr(self, name) < 1:
                raise MappingError(f"{name} is {getattr(self, name)}; expected 1 or more")
        if self.form not in get_args(AlignmentForm):
            raise MappingError(
                f"form is {self.form!r}; expected {' or '.join(get_args(AlignmentForm))}"
            )
