"""What the update of cells needs to know besides the sums of a frame."""

from __future__ import annotations

from typing import NamedTuple

from mapping.settings import MapSettings


class FrameConstants(NamedTuple):
    """One frame's geometry and common errors, in T; see `mapping.measurement`.

    first_column, first_row: the window's corner in the layers, which wrap around. corner_*: that
    corner relative to the camera. camera_*: the camera in T. lever_*: camera minus tracked body.
    rXY: elements of C_TS. pose_*: entries of the pose covariance, z, rotation about x and about y.
    mount_rad: sigma of the mount's rotation. bias_*: sigma of the depth bias is bias_0 +
    bias_2 z^2. range_min_m: no reading is nearer. frame_*, drift_per_m: of the gate alone, see
    `mapping.motion.pose_errors`. repeats: frames before this one that were taken from the same
    place. fixed_share: of the pixels' noise, see `mapping.noise`.
    """

    t_ns: int
    first_column: int
    first_row: int
    cells_x: int
    cells_y: int
    cell_size_m: float
    corner_x_m: float
    corner_y_m: float
    camera_x_m: float
    camera_y_m: float
    camera_z_m: float
    lever_x_m: float
    lever_y_m: float
    r00: float
    r01: float
    r02: float
    r10: float
    r11: float
    r12: float
    r22: float
    pose_zz: float
    pose_za: float
    pose_zb: float
    pose_aa: float
    pose_ab: float
    pose_bb: float
    mount_rad: float
    bias_0_m: float
    bias_2_per_m: float
    correlation_area_px: float
    range_min_m: float
    frame_m2: float = 0.0
    frame_rad2: float = 0.0
    drift_per_m: float = 0.0
    repeats: float = 0.0
    fixed_share: float = 0.0


class FusionConstants(NamedTuple):
    """How measurements are fused; see `mapping.settings.MapSettings`."""

    gate2: float
    floor_m2: float
    ceiling_m2: float
    correlation_time_ns: float
    confirmations: int


def fusion_constants(settings: MapSettings) -> FusionConstants:
    """Return the settings in the units of the loop."""
    return FusionConstants(
        gate2=settings.gate_sigma**2,
        floor_m2=settings.sigma_floor_m**2,
        ceiling_m2=settings.sigma_ceiling_m**2,
        correlation_time_ns=settings.common_correlation_time_s * 1e9,
        confirmations=settings.confirmations,
    )
