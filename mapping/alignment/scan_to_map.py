"""Scan-to-map alignment: the pose from which a depth frame best fits the map (point to plane).

The frame's readings are averaged per cell, so that a cell's many readings speak once. Each mean p
is held against the plane through the 3 x 3 cells of the map under it:

    minimise  sum w(r) r^2,   r = n . (p - p0),   p = r_TB + dt + exp([dtheta]x) (p_prior - r_TB)

by Gauss-Newton over (dt, dtheta), from the prior, only along the directions that the points fix.
Point to plane: Chen and Medioni, "Object modelling by registration of multiple range images", 1992.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mapping.alignment.frame_points import FramePoints, PointGrouper
from mapping.alignment.observability import covariance, metres_per_unit, observable_directions
from mapping.alignment.plane_problem import NormalEquations, PlaneProblem
from mapping.alignment.settings import AlignmentSettings
from mapping.cells.grid import Grid
from mapping.geometry import RigidTransform, UncertainPose
from mapping.measurement import FrameReducer, View

Float64Array = NDArray[np.float64]

# Gauss-Newton ends when a step, rotations taken at the lever, is no longer than this.
_CONVERGED_M = 2e-5


@dataclass(frozen=True, slots=True)
class Alignment:
    """What the map says of a frame's pose.

    Attributes:
        pose: aligned pose of the tracked body. Along directions that the points do not fix it is
            the prior's, and its covariance is very large there.
        directions: (6, k) orthonormal directions of (shift, rotation times lever) that were fixed.
        points: points that met a plane of the map.
        sigma_scale: spread of the residuals over their claimed sigma.
        steps: Gauss-Newton steps that were made.
    """

    pose: UncertainPose
    directions: Float64Array
    points: int
    sigma_scale: float
    steps: int


class ScanAligner:
    """Aligns frames with a map; keeps its work arrays from frame to frame."""

    def __init__(self, settings: AlignmentSettings, cell_size_m: float) -> None:
        self.settings = settings
        self._grouper = PointGrouper(cell_size_m, settings.fewest_pixels)
        self._problem = PlaneProblem(settings, cell_size_m)

    def align(self, reducer: FrameReducer, view: View, grid: Grid) -> Alignment | None:
        """Return the pose that fits the map, or None where the map fixes nothing of it.

        Args:
            reducer: has the frame loaded.
            view: the prior; its covariance does not matter.
            grid: the map, which is not changed.
        """
        window = reducer.footprint(view).intersection(grid.extent)
        if window.is_empty:
            return None
        points = self._grouper.group(reducer, view, window)
        self._problem.take(grid, window)
        return self._solve(points, view.body)

    def _solve(self, points: FramePoints, prior: UncertainPose) -> Alignment | None:
        shift, rotation = np.zeros(3), np.eye(3)
        sums = self._problem.linearise(points, shift, rotation, np.inf)
        directions = observable_directions(sums.normal - sums.noise, sums.points, self.settings)
        if directions.shape[1] == 0:
            return None
        steps = 0
        size = np.inf
        while steps < self.settings.iterations and size > _CONVERGED_M:
            robust = self.settings.robust_sigma * max(sums.sigma_scale, 1.0)
            sums = self._problem.linearise(points, shift, rotation, robust)
            if sums.points < self.settings.fewest_points:
                return None
            step = self._step(sums, directions)
            shift = shift + step[:3]
            rotation = Rotation.from_rotvec(step[3:]).as_matrix() @ rotation
            size = float(np.abs(step * metres_per_unit(self.settings)).max())
            steps += 1
        body = prior.transform
        aligned = RigidTransform(rotation @ body.rotation, body.translation_m + shift)
        sigma = covariance(sums, directions, self.settings)
        pose = replace(prior, transform=aligned, covariance=sigma)
        return Alignment(pose, directions, sums.points, sums.sigma_scale, steps)

    def _step(self, sums: NormalEquations, directions: Float64Array) -> Float64Array:
        """Return the Gauss-Newton step (6,) along the directions."""
        along = directions / metres_per_unit(self.settings)[:, np.newaxis]
        solution = np.linalg.solve(along.T @ sums.normal @ along, along.T @ sums.gradient)
        return -along @ solution
