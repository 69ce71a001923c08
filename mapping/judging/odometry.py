"""A trajectory against the true one: how far off, how fast it drifts, and whether it knows.

ATE and RPE are those of the usual trajectory tools:

    ATE   |p_est - p_true| at every pose, after one alignment of the whole trajectory
    RPE   of pairs a distance apart: E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j), |translation| and angle

with Q true, P estimated; pairs follow each other without overlap, their distance is measured
along the true way. The truth is interpolated to the estimate's times. NEES is that of x, y, z and
yaw, both trajectories put together at their first common pose, for that is where an estimate that
starts at the origin is certain.
"""

from __future__ import annotations

import math
from typing import get_args

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from mapping.errors import MappingError
from mapping.geometry import Float64Array
from mapping.judging.odometry_scores import Alignment, Nees, OdometryScores, Spread
from mapping.judging.trajectory import Int64Array, Path3D

_MAX_GAP_S = 0.1
_PLANAR = [0, 1, 2, 5]
_DOF = 4
# The first poses are certain by definition, and no error has a scale there.
_LEAST_VARIANCE = 1e-10


def evaluate_odometry(
    estimate: Path3D, truth: Path3D, alignment: Alignment = "start"
) -> OdometryScores:
    """Compare an estimate with the truth.

    Args:
        estimate: with or without covariances.
        truth: of the same body.
        alignment: how ATE puts them together: not at all, at the first common pose (place and
            heading), by the best place and heading, or by the best rigid motion.

    Raises:
        MappingError: no such alignment, or they have fewer than two times in common.
    """
    if alignment not in get_args(Alignment):
        expected = ", ".join(get_args(Alignment))
        raise MappingError(f"alignment is {alignment!r}; expected one of {expected}")
    est, true = _in_common(estimate, truth)
    aligned = _moved(est, *_alignment(est, true, alignment))
    way = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(true.position_m, axis=0), axis=1))]
    )
    elapsed = (true.t_ns - true.t_ns[0]) * 1e-9
    metre, second = (relative_errors(est, true, axis, 1.0) for axis in (way, elapsed))
    apart = aligned.position_m - true.position_m
    error, sigma, nees = _consistency(est, true)
    return OdometryScores(
        estimate=estimate.name,
        truth=truth.name,
        alignment=alignment,
        poses=len(true),
        seconds=float(elapsed[-1]),
        metres=float(way[-1]),
        ate_m=Spread.of(np.linalg.norm(apart, axis=1)),
        ate_horizontal_m=Spread.of(np.linalg.norm(apart[:, :2], axis=1)),
        ate_yaw_deg=Spread.of(np.abs(np.degrees(yaw_errors(aligned, true)))),
        per_metre_m=Spread.of(metre[0]),
        per_metre_deg=Spread.of(np.degrees(metre[1])),
        per_second_m=Spread.of(second[0]),
        per_second_deg=Spread.of(np.degrees(second[1])),
        nees=None if est.covariance is None else _nees(nees),
        t_ns=true.t_ns,
        error=error,
        sigma=sigma,
        nees_values=nees,
        estimated_m=aligned.position_m,
        true_m=true.position_m,
    )


def _in_common(estimate: Path3D, truth: Path3D) -> tuple[Path3D, Path3D]:
    """Return both at the times of the estimate that the truth covers.

    Raises:
        MappingError: there are fewer than two.
    """
    true, inside = truth.at(estimate.t_ns, _MAX_GAP_S)
    if len(true) < 2:
        raise MappingError(
            f"{estimate.name} and {truth.name} have {len(true)} times in common; expected the "
            "same clock and an overlap"
        )
    covariance = None if estimate.covariance is None else estimate.covariance[inside]
    position_m, rotation = estimate.position_m[inside], estimate.rotation[inside]
    return Path3D(estimate.name, true.t_ns, position_m, rotation, covariance), true


def relative_errors(
    estimate: Path3D, truth: Path3D, axis: Float64Array, step: float
) -> tuple[Float64Array, Float64Array]:
    """Return RPE (K,) in m and rad of the pairs that are one step apart along an axis.

    Args:
        estimate, truth: at the same N times.
        axis: (N,) way or time of the poses, not decreasing.
        step: distance of a pair on it.
    """
    ends = [0]
    while (following := int(np.searchsorted(axis, axis[ends[-1]] + step - 1e-9))) < len(axis):
        ends.append(following)
    if len(ends) < 2:
        return np.zeros(0), np.zeros(0)
    i, j = np.array(ends[:-1]), np.array(ends[1:])
    moved_e, turned_e = _between(estimate, i, j)
    moved_t, turned_t = _between(truth, i, j)
    apart = turned_t.inv().apply(moved_e - moved_t)
    angle = (turned_t.inv() * turned_e).magnitude()
    return np.linalg.norm(apart, axis=1), np.asarray(angle, np.float64)


def _between(path: Path3D, i: Int64Array, j: Int64Array) -> tuple[Float64Array, Rotation]:
    """Return the motions from poses i to poses j in the axes of i."""
    back = path.rotation[i].inv()
    return back.apply(path.position_m[j] - path.position_m[i]), back * path.rotation[j]


def yaw_errors(estimate: Path3D, truth: Path3D) -> Float64Array:
    """Return (N,) how far the estimate is turned about the vertical, rad.

    Of the rotation between the two, in fixed axes: its twist about z.
    """
    quat = (estimate.rotation * truth.rotation.inv()).as_quat(canonical=True)
    return np.asarray(2.0 * np.arctan2(quat[:, 2], quat[:, 3]), np.float64)


def _alignment(estimate: Path3D, truth: Path3D, kind: Alignment) -> tuple[Rotation, Float64Array]:
    """Return rotation and translation that put the estimate onto the truth."""
    if kind == "none":
        return Rotation.identity(), np.zeros(3)
    if kind == "start":
        first = Path3D("", truth.t_ns[:1], truth.position_m[:1], truth.rotation[:1])
        start = Path3D("", first.t_ns, estimate.position_m[:1], estimate.rotation[:1])
        turn = Rotation.from_rotvec([0.0, 0.0, -float(yaw_errors(start, first)[0])])
        return turn, truth.position_m[0] - turn.apply(estimate.position_m[0])
    middle_e, middle_t = estimate.position_m.mean(axis=0), truth.position_m.mean(axis=0)
    e, t = estimate.position_m - middle_e, truth.position_m - middle_t
    if kind == "yaw":
        angle = math.atan2(
            float((e[:, 0] * t[:, 1] - e[:, 1] * t[:, 0]).sum()), float((e[:, :2] * t[:, :2]).sum())
        )
        turn = Rotation.from_rotvec([0.0, 0.0, angle])
    else:
        # Horn's and Umeyama's closed form without scale.
        u, _, vt = np.linalg.svd(t.T @ e)
        mirror = np.diag([1.0, 1.0, np.linalg.det(u @ vt)])
        turn = Rotation.from_matrix(u @ mirror @ vt)
    return turn, middle_t - turn.apply(middle_e)


def _moved(path: Path3D, turn: Rotation, shift_m: Float64Array) -> Path3D:
    """Return a path turned about the origin, then shifted; its covariance is left out."""
    return Path3D(path.name, path.t_ns, turn.apply(path.position_m) + shift_m, turn * path.rotation)


def _consistency(
    estimate: Path3D, truth: Path3D
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return errors (N, 4) of x, y, z, yaw in the estimate's axes, their sigmas, and NEES/dof."""
    turn, shift = _alignment(truth, estimate, "start")
    true = _moved(truth, turn, shift)
    yaw = yaw_errors(estimate, true)
    error = np.column_stack([estimate.position_m - true.position_m, yaw])
    if estimate.covariance is None:
        return error, np.full(error.shape, np.nan), np.full(len(error), np.nan)
    # What is certain of the start is that the trajectories are together there.
    covariance = estimate.covariance[:, _PLANAR][:, :, _PLANAR] + _LEAST_VARIANCE * np.eye(_DOF)
    solved = np.linalg.solve(covariance, error[:, :, np.newaxis])[:, :, 0]
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return error, sigma, (error * solved).sum(axis=1) / _DOF


def _nees(values: Float64Array) -> Nees:
    """Return what (N,) values of NEES over its degrees of freedom come to."""
    bounds = chi2.ppf([0.025, 0.975], _DOF) / _DOF
    inside = float((values <= chi2.ppf(0.95, _DOF) / _DOF).mean())
    return Nees(float(values.mean()), inside, float(bounds[0]), float(bounds[1]))
