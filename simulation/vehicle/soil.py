"""Forces between a rigid body's surface and soft ground: pressure from sinkage, shear from slip.

The body's surface is cut into small elements. An element that is d below the ground, measured
along the ground's normal, feels

    p   = (k_c / b + k_phi) d^n (1 + kappa tanh(v_in / v_k))            normal to the element
    tau = (c + p tan phi) (1 - exp(-|j| / K))                           against the slip

with b the smaller side of the contact (Bekker 1969) and j the distance that the element has
slipped since it touched the ground (Janosi and Hanamoto 1961). The factor with kappa stands for
the work of compaction: soil pushes less when it is left (v_in < 0) than when it is entered. It is
rate-independent above the small speed v_k, and viscous below, so that a body comes to rest.
Because j remembers, a body at rest on a slope is held and does not creep.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulation.terrain.height_grid import Float32Array, surface_plane

Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]

# Slip beyond this many K changes nothing any more, but would delay the answer to a reversal.
_FULL_SHEAR = 3.0


@dataclass(frozen=True, slots=True)
class Soil:
    """Constants of the ground; the defaults are loose lunar soil.

    Bekker and shear constants as in the Lunar Sourcebook (Heiken et al. 1991, chapter 9) for
    vehicles. Compaction, damping and `sideways` are ours: they make a wheel of the Jackal roll
    with a slip near 0 on level ground, and the vehicle turn as its effective track says.

    Attributes:
        k_c: cohesive modulus, N/m^(n+1).
        k_phi: frictional modulus, N/m^(n+2).
        exponent: n.
        cohesion_pa: c.
        friction_rad: phi.
        shear_length_m: K.
        compaction: kappa, share of the pressure.
        compaction_speed_m_s: v_k.
        shear_damping_s_m: viscous shear per pressure and slip speed; inside the shear's limit.
        sideways: shear along the axle over shear along the rim, whose lugs stand across it.
    """

    k_c: float = 1400.0
    k_phi: float = 820e3
    exponent: float = 1.0
    cohesion_pa: float = 170.0
    friction_rad: float = float(np.radians(37.0))
    shear_length_m: float = 0.0178
    compaction: float = 0.7
    compaction_speed_m_s: float = 0.05
    shear_damping_s_m: float = 1.0
    sideways: float = 0.7

    def constants(self) -> Float64Array:
        """Return the (10,) attributes in their order, for the kernel."""
        return np.array(astuple(self), dtype=np.float64)


def rim_elements(radius_m: float, width_m: float, around: int, across: int) -> Float64Array:
    """Return the (around * across, 13) elements of a wheel's rim about the y axis.

    Columns: position, outward normal, tangent (the way the rim moves when the wheel turns
    forwards), axle, area; in the wheel's frame, metres.
    """
    angle = 2.0 * np.pi * np.arange(around) / around
    y = width_m * ((np.arange(across) + 0.5) / across - 0.5)
    angle, y = (a.ravel() for a in np.meshgrid(angle, y, indexing="ij"))
    zero = np.zeros_like(angle)
    normal = np.column_stack([np.cos(angle), zero, np.sin(angle)])
    tangent = np.column_stack([np.sin(angle), zero, -np.cos(angle)])
    position = radius_m * normal + np.column_stack([zero, y, zero])
    axle = np.tile([0.0, 1.0, 0.0], (angle.size, 1))
    area = np.full((angle.size, 1), 2.0 * np.pi * radius_m * width_m / angle.size)
    return np.hstack([position, normal, tangent, axle, area])


def plate_elements(
    centre_m: tuple[float, float, float],
    side_u_m: tuple[float, float, float],
    side_v_m: tuple[float, float, float],
    parts: tuple[int, int],
) -> Float64Array:
    """Return the (parts u * parts v, 13) elements of a rectangle; its normal is u x v.

    Columns as in `rim_elements`, with the directions of u and v for tangent and axle.
    """
    u, v = np.array(side_u_m), np.array(side_v_m)
    normal = np.cross(u, v)
    area = float(np.linalg.norm(normal)) / (parts[0] * parts[1])
    directions = np.hstack([a / np.linalg.norm(a) for a in (normal, u, v)])
    along_u = (np.arange(parts[0]) + 0.5) / parts[0] - 0.5
    along_v = (np.arange(parts[1]) + 0.5) / parts[1] - 0.5
    at_u, at_v = (a.reshape(-1, 1) for a in np.meshgrid(along_u, along_v, indexing="ij"))
    constant = np.tile(np.append(directions, area), (at_u.size, 1))
    return np.hstack([np.array(centre_m) + at_u * u + at_v * v, constant])


# A body in a kernel is one row: origin (0:3), rotation to the world row by row (3:12), velocity of
# the origin (12:15) and angular velocity (15:18), world axes.
BODY_COLUMNS = 18


@njit(cache=True, inline="always", error_model="numpy")
def _turned(body: Float64Array, element: Float64Array, k: int) -> tuple[float, float, float]:
    """Return the vector in columns k to k+2 of an element, in world axes."""
    x, y, z = element[k], element[k + 1], element[k + 2]
    return (
        body[3] * x + body[4] * y + body[5] * z,
        body[6] * x + body[7] * y + body[8] * z,
        body[9] * x + body[10] * y + body[11] * z,
    )


@njit(cache=True, inline="always", error_model="numpy")
def _depth(
    ground: tuple[Float32Array, float, float, float],
    x: float,
    y: float,
    z: float,
    normal: tuple[float, float, float],
) -> float:
    """Return how far a point is below the ground; 0 above it, outside it, or facing away."""
    height, slope_x, slope_y = surface_plane(ground[0], ground[1], ground[2], ground[3], x, y)
    below = height - z  # NaN outside the grid: the comparison is false then
    if below > 0.0 and normal[2] < normal[0] * slope_x + normal[1] * slope_y:
        return below / float(np.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y))
    return 0.0


@njit(cache=True, inline="always", error_model="numpy")
def _shear(
    soil: Float64Array,
    pressure: float,
    grip: float,
    slip_t_m_s: float,
    slip_a_m_s: float,
    dt_s: float,
    slipped_m: Float64Array,
) -> tuple[float, float]:
    """Move j on by one step; return the shear stress along tangent and axle, Pa."""
    longest = _FULL_SHEAR * soil[5]
    j_t = slipped_m[0] + slip_t_m_s * dt_s
    j_a = slipped_m[1] + slip_a_m_s * dt_s
    j = np.sqrt(j_t * j_t + j_a * j_a)
    if j > longest:
        j_t, j_a, j = j_t * longest / j, j_a * longest / j, longest
    slipped_m[0], slipped_m[1] = j_t, j_a
    strength = grip * (soil[3] + pressure * np.tan(soil[4]))
    per_metre = strength / soil[5] if j == 0.0 else strength * (1.0 - np.exp(-j / soil[5])) / j
    viscous = grip * soil[8] * pressure
    shear_t = -per_metre * j_t - viscous * slip_t_m_s
    shear_a = -per_metre * j_a - viscous * slip_a_m_s
    shear = np.sqrt(shear_t * shear_t + shear_a * shear_a)
    limit = min(1.0, strength / shear) if shear > 0.0 else 1.0
    return shear_t * limit, shear_a * limit * soil[9]


@njit(cache=True, nogil=True, error_model="numpy")
def press(
    ground: tuple[Float32Array, float, float, float],
    soil: Float64Array,
    stiffness: float,
    grip: float,
    elements: Float64Array,
    slipped_m: Float64Array,
    body: Float64Array,
    dt_s: float,
    wrench: Float64Array,
) -> None:
    """Write the force and the torque about the body's origin that the ground exerts on it.

    Args:
        ground: heights, x and y of node [0, 0], spacing, as in `HeightGrid`.
        soil: `Soil.constants`.
        stiffness: k_c / b + k_phi of this body.
        grip: factor on the shear strength; 1 unless the wheels are to slip.
        elements: (N, 13) of the body, see `rim_elements`.
        slipped_m: (N, 2) distance j along tangent and axle; kept from step to step.
        body: (18,) state, see BODY_COLUMNS.
        dt_s: length of the step.
        wrench: (6,) is written, world axes.
    """
    wrench[:] = 0.0
    for i in range(elements.shape[0]):
        element = elements[i]
        rx, ry, rz = _turned(body, element, 0)
        nx, ny, nz = _turned(body, element, 3)
        depth = _depth(ground, body[0] + rx, body[1] + ry, body[2] + rz, (nx, ny, nz))
        if depth <= 0.0:
            slipped_m[i] = 0.0
            continue
        vx = body[12] + body[16] * rz - body[17] * ry
        vy = body[13] + body[17] * rx - body[15] * rz
        vz = body[14] + body[15] * ry - body[16] * rx
        entering = vx * nx + vy * ny + vz * nz
        pressure = stiffness * depth ** soil[2] * (1.0 + soil[6] * np.tanh(entering / soil[7]))
        tx, ty, tz = _turned(body, element, 6)
        ax, ay, az = _turned(body, element, 9)
        slip_t, slip_a = vx * tx + vy * ty + vz * tz, vx * ax + vy * ay + vz * az
        along, sideways = _shear(soil, pressure, grip, slip_t, slip_a, dt_s, slipped_m[i])
        fx = element[12] * (along * tx + sideways * ax - pressure * nx)
        fy = element[12] * (along * ty + sideways * ay - pressure * ny)
        fz = element[12] * (along * tz + sideways * az - pressure * nz)
        wrench[0] += fx
        wrench[1] += fy
        wrench[2] += fz
        wrench[3] += ry * fz - rz * fy
        wrench[4] += rz * fx - rx * fz
        wrench[5] += rx * fy - ry * fx
