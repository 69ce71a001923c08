"""Where the plate ends in the image, and so where its middle and its corners are in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration_rigs.plate_rig.manifest import Rig
from calibration_rigs.plate_rig.plane import DisparityPlane
from drivers.samples import CameraIntrinsics

Float64Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# Share of the rows (columns) that an edge is taken from: corners are left out.
_MIDDLE = 0.8
_STRAY_PX = 2.0
# An edge this near to the end of the sensor's range is where the range ends, not the plate.
_AT_RANGE_END = 0.03
# How well the place of an edge is known.
EDGE_SIGMA_PX = 0.5


@dataclass(frozen=True, slots=True)
class Edge:
    """One edge of the plate in the image.

    Attributes:
        place_px: column (row) of the edge at the middle of the plate.
        slope: how it runs, pixels per pixel; 0 = along the image.
        first, last: rows (columns) that it was taken from.
        is_seen: the plate ends there, rather than the image or the sensor's range.
    """

    place_px: float
    slope: float
    first: int
    last: int
    is_seen: bool


@dataclass(frozen=True, slots=True)
class Outline:
    """The plate's edges, and what they come to in space.

    Attributes:
        left, right, top, bottom: edges.
        cut_sides: where the border of the image cuts the plate off.
        width_m, height_m: between the edges; what is cut off is not in it.
        middle_m: (3,) of the plate in the optical frame, by the edges that are seen and the
            plate's known size.
        middle_z_sigma_m: how well the depth of the middle is known, from the edges' pixels.
        corners_z_m: depth of the top left, top right and bottom left corner.
        roll_rad: how far the side edges are from upright.
    """

    left: Edge
    right: Edge
    top: Edge
    bottom: Edge
    cut_sides: tuple[str, ...]
    width_m: float
    height_m: float
    middle_m: tuple[float, float, float]
    middle_z_sigma_m: float
    corners_z_m: tuple[float, float, float]
    roll_rad: float


def outline(whole: BoolArray, plane: DisparityPlane, camera: CameraIntrinsics, rig: Rig) -> Outline:
    """Return the outline of the plate.

    Args:
        whole: (height, width) pixels on the plate, not eroded.
        plane: the plate's.
        camera: intrinsics.
        rig: the plate's true size and the sensor's range.
    """
    columns, rows = np.flatnonzero(whole.any(axis=0)), np.flatnonzero(whole.any(axis=1))
    u_mid, v_mid = 0.5 * (columns[0] + columns[-1]), 0.5 * (rows[0] + rows[-1])
    ends: dict[str, Edge] = {}
    for name, mask, size, middle in (
        ("left", whole, camera.width_px, v_mid),
        ("right", whole[:, ::-1], camera.width_px, v_mid),
        ("top", whole.T, camera.height_px, u_mid),
        ("bottom", whole[::-1].T, camera.height_px, u_mid),
    ):
        ends[name] = _edge(mask, size, middle, mirrored=name in ("right", "bottom"))
    cut = tuple(name for name, edge in ends.items() if not edge.is_seen)
    z = {name: plane.z_m(ends[name].place_px, v_mid) for name in ("left", "right")}
    for name in ("left", "right"):
        at_end = z[name] < rig.range_min_m * (1.0 + _AT_RANGE_END) or z[name] > rig.range_max_m * (
            1.0 - _AT_RANGE_END
        )
        if at_end:
            edge = ends[name]
            ends[name] = Edge(edge.place_px, edge.slope, edge.first, edge.last, is_seen=False)
    return _in_space(ends, cut, plane, camera, rig, (u_mid, v_mid))


def _edge(mask: BoolArray, size: int, middle: float, *, mirrored: bool) -> Edge:
    """Return the line of the first pixel of each row of `mask`, robustly."""
    lines = np.flatnonzero(mask.any(axis=1))
    margin = int(0.5 * (1.0 - _MIDDLE) * lines.size)
    lines = lines[margin : lines.size - margin]
    first = np.argmax(mask[lines], axis=1) - 0.5
    fit = np.array([0.0, float(np.median(first))])
    for _ in range(3):
        near = np.abs(first - np.polyval(fit, lines - middle)) < _STRAY_PX
        if np.count_nonzero(near) < 8:
            break
        fit = np.polyfit(lines[near] - middle, first[near], 1)
    slope, place = float(fit[0]), float(fit[1])
    is_seen = float(np.median(first)) > 1.0
    if mirrored:
        slope, place = -slope, size - 1.0 - place
    return Edge(place, slope, int(lines[0]), int(lines[-1]), is_seen)


def _in_space(
    ends: dict[str, Edge],
    cut: tuple[str, ...],
    plane: DisparityPlane,
    camera: CameraIntrinsics,
    rig: Rig,
    middle_px: tuple[float, float],
) -> Outline:
    normal = plane.normal(camera)
    along = np.array([normal[2], 0.0, -normal[0]]) / np.hypot(normal[0], normal[2])
    down = np.cross(normal, along) / np.linalg.norm(normal)
    left = _point(plane, camera, ends["left"].place_px, middle_px[1])
    right = _point(plane, camera, ends["right"].place_px, middle_px[1])
    top = _point(plane, camera, middle_px[0], ends["top"].place_px)
    bottom = _point(plane, camera, middle_px[0], ends["bottom"].place_px)
    across = _middle(left @ along, right @ along, ends["left"], ends["right"], rig.plate_width_m)
    upright = _middle(top @ down, bottom @ down, ends["top"], ends["bottom"], rig.plate_height_m)
    if not (ends["top"].is_seen or ends["bottom"].is_seen):
        upright = float(left @ down)  # cut above and below: taken as symmetric
    toward = normal / float(normal @ normal)  # the plane's point nearest to the camera
    middle = toward + across * along + upright * down
    half_width, half_height = 0.5 * rig.plate_width_m * along, 0.5 * rig.plate_height_m * down
    corners = (
        middle - half_width - half_height,
        middle + half_width - half_height,
        middle - half_width + half_height,
    )
    seen = int(ends["left"].is_seen) + int(ends["right"].is_seen)
    per_px = abs(plane.a) * middle[2] ** 2
    lost = 0.5 * rig.plate_width_m * abs(along[2])
    sigma = EDGE_SIGMA_PX * per_px / np.sqrt(seen) if seen else lost
    upright_slopes = [ends[name].slope for name in ("left", "right") if ends[name].is_seen]
    facing = abs(normal[0]) < np.sin(np.radians(20.0)) * np.linalg.norm(normal)
    roll = float(np.arctan(np.mean(upright_slopes))) if upright_slopes and facing else 0.0
    return Outline(
        ends["left"],
        ends["right"],
        ends["top"],
        ends["bottom"],
        cut,
        float(np.linalg.norm(right - left)),
        float(np.linalg.norm(bottom - top)),
        (float(middle[0]), float(middle[1]), float(middle[2])),
        float(sigma),
        (float(corners[0][2]), float(corners[1][2]), float(corners[2][2])),
        roll,
    )


def _middle(low: float, high: float, first: Edge, second: Edge, size_m: float) -> float:
    """Return the middle between two edges, or half a plate away from the one that is seen."""
    if first.is_seen and not second.is_seen:
        return low + 0.5 * size_m
    if second.is_seen and not first.is_seen:
        return high - 0.5 * size_m
    return 0.5 * (low + high)


def _point(plane: DisparityPlane, camera: CameraIntrinsics, u: float, v: float) -> Float64Array:
    """Return the plane's point at a pixel, optical frame, metres."""
    z = plane.z_m(u, v)
    return np.array(
        [(u - camera.cx_px) / camera.fx_px * z, (v - camera.cy_px) / camera.fy_px * z, z]
    )
