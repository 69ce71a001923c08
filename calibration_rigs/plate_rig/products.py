"""What a calibration leaves: the file for the mapper, the factors ROS users know, the tables."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from math import degrees, pi, radians

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from calibration_rigs.plate_rig.cell_result import CellResult
from calibration_rigs.plate_rig.process import PlateResult, worst_held_out
from mapping.calibration_file import DeviceIdentity, Measured, ValidityBox, noise_to_json
from mapping.noise import DepthNoiseModel
from mapping.output.netcdf import software

Float64Array = NDArray[np.float64]

# A terrain camera looks at the ground at about this angle; the factors have no angle of their own.
# What tells the ROS factors from a configuration that somebody wrote.
ROS_MARK = "; steps included."
_TYPICAL_ANGLE_RAD = radians(45.0)


def quantum_per_m(result: PlateResult) -> float:
    """Return k of the depth step k z^2."""
    camera, rig = result.cells[0].camera, result.manifest.rig
    return rig.disparity_step_px / rig.disparity_px_m(camera.fx_px, camera.width_px)


def noise_model(result: PlateResult) -> DepthNoiseModel:
    """Return the mapper's model: the best law, the steps, the bias and what is left of it."""
    used = result.used
    z_m = np.array([cell.z_m for cell in used])
    law = result.laws[0].as_model(quantum_per_m(result))
    s0, s2 = result.bias.as_line(z_m)
    b0, b1, b2 = map(float, result.bias.coefficients)
    area = float(np.median([cell.correlation_area_px for cell in used]))
    return DepthNoiseModel(
        name=f"plate-{result.laws[0].name}",
        axial_offset_m=law.axial_offset_m,
        axial_quadratic_per_m=law.axial_quadratic_per_m,
        axial_reference_m=law.axial_reference_m,
        axial_angle_m_sqrt_m=law.axial_angle_m_sqrt_m,
        lateral_offset_px=result.lateral[0],
        lateral_angle_px=result.lateral[1],
        quantum_per_m=law.quantum_per_m,
        bias_m=b0,
        bias_slope=b1,
        bias_quadratic_per_m=b2,
        bias_sigma_m=s0,
        bias_sigma_quadratic_per_m=s2,
        correlation_area_px=max(area, 1.0),
        range_min_m=float(z_m.min()),
        range_max_m=float(z_m.max()),
    )


def calibration_json(result: PlateResult) -> str:
    """Return the calibration file.

    Raises:
        MappingError: the mapper could not use the model.
    """
    device = DeviceIdentity(model=result.device.model, serial=result.device.serial)
    return noise_to_json(noise_model(result), device, measured(result))


def measured(result: PlateResult) -> Measured:
    """Return how the model was measured, and where it holds."""
    used, best, camera = result.used, result.laws[0], result.cells[0].camera
    lux = [cell.cell.lux for cell in used if cell.cell.lux is not None]
    warmth = [cell.cell.temperature_c for cell in used if cell.cell.temperature_c is not None]
    rig = result.manifest.rig
    return Measured(
        validity=ValidityBox(
            range_min_m=min(cell.z_m for cell in used),
            range_max_m=max(cell.z_m for cell in used),
            incidence_max_rad=max(cell.incidence_rad for cell in used),
            lux_min=min(lux, default=None),
            lux_max=max(lux, default=None),
            temperature_min_c=min(warmth, default=None),
            temperature_max_c=max(warmth, default=None),
        ),
        environment=" and ".join(sorted({cell.cell.environment for cell in used})),
        law=best.name,
        parameters=tuple(map(float, best.parameters)),
        covariance=_rows(best.covariance),
        held_out_share=min(worst_held_out(result), 1e6),
        bias_covariance=_rows(result.bias.covariance),
        tape_zero_sigma_m=result.bias.zero_sigma_m,
        cells=len(used),
        frames=sum(cell.frames for cell in used),
        effective_readings=float(np.median([cell.spread.effective for cell in used])),
        disparity_px_m=rig.disparity_px_m(camera.fx_px, camera.width_px),
        disparity_step_px=rig.disparity_step_px,
        intrinsics_px=(camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px),
        size_px=(camera.width_px, camera.height_px),
        raw_sha256=result.sha256,
        software=software(),
    )


def _rows(matrix: Float64Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(map(float, row)) for row in matrix)


def ros_yaml(result: PlateResult) -> str:
    """Return the sensor factors of the elevation mapping that ROS users know.

    There var = (a + b (z - c)^2 + d z^e)^2 along the ray and (lateral_factor z)^2 across it;
    a, b, c are fitted to this model facing the plate, d and e are its angle term at 45 degrees.
    """
    model = noise_model(result)
    z_m = np.linspace(model.range_min_m, model.range_max_m, 50)
    spread = model.axial_sigma_m(z_m, np.zeros_like(z_m))

    def residuals(p: Float64Array) -> Float64Array:
        """Return (50,) log of the law a + b (z - c)^2 over this model facing the plate."""
        off: Float64Array = np.log((p[0] + p[1] * (z_m - p[2]) ** 2) / spread)
        return off

    start = np.array([0.5 * float(spread[0]), 2e-3, 0.3])
    fit = least_squares(residuals, start, bounds=([1e-6, 0.0, 0.0], [1.0, 1.0, z_m[0]]))
    a, b, c = map(float, fit.x)
    ratio = _TYPICAL_ANGLE_RAD / (pi / 2.0 - _TYPICAL_ANGLE_RAD)
    worst = float(np.abs(np.expm1(residuals(fit.x))).max())
    lateral_px = model.lateral_offset_px + model.lateral_angle_px * ratio
    focal_px = measured(result).disparity_px_m / result.manifest.rig.baseline_m
    device = f"{result.device.model} {result.device.serial}".strip() or "unknown device"
    return "\n".join(
        [
            f"# {device}, {model.range_min_m:.2f} to {model.range_max_m:.2f} m{ROS_MARK}",
            f"# a, b, c within {100.0 * worst:.1f} % of the measured law; d at 45 degrees.",
            "sensor_processor:",
            "  type: structured_light",
            f"  cutoff_min_depth: {model.range_min_m:.3f}",
            f"  cutoff_max_depth: {model.range_max_m:.3f}",
            f"  normal_factor_a: {a:.6g}",
            f"  normal_factor_b: {b:.6g}",
            f"  normal_factor_c: {c:.6g}",
            f"  normal_factor_d: {model.axial_angle_m_sqrt_m * ratio**2:.6g}",
            "  normal_factor_e: -0.5",
            f"  lateral_factor: {lateral_px / focal_px:.6g}",
            "",
        ]
    )


# Column of the CSV -> how a cell fills it. Lengths in metres, angles in degrees.
_COLUMNS: dict[str, Callable[[CellResult], str | float]] = {
    "recording": lambda c: c.cell.recording,
    "environment": lambda c: c.cell.environment,
    "distance_m": lambda c: c.cell.distance_m,
    "angle_deg": lambda c: c.cell.angle_deg,
    "used": lambda c: int(c.is_used),
    "z_m": lambda c: c.z_m,
    "incidence_deg": lambda c: degrees(c.incidence_rad),
    "turn_deg": lambda c: degrees(c.turn_rad),
    "tip_deg": lambda c: degrees(c.tip_rad),
    "roll_deg": lambda c: degrees(c.roll_rad),
    "frames": lambda c: c.frames,
    "pixels": lambda c: c.pixels,
    "readings": lambda c: c.spread.readings,
    "effective_readings": lambda c: c.spread.effective,
    "correlation_area_px": lambda c: c.correlation_area_px,
    "step_m": lambda c: c.step_m,
    "sigma_m": lambda c: c.sigma_m,
    "sigma_is_bound": lambda c: int(c.spread.is_below),
    "sigma_low_m": lambda c: c.spread.low * c.step_m,
    "sigma_high_m": lambda c: c.spread.high * c.step_m,
    "sigma_per_step": lambda c: c.spread.sigma,
    "plane_rms_m": lambda c: c.plain_sigma_m,
    "sigma_sheppard_m": lambda c: c.sheppard_sigma_m,
    "chi2_p": lambda c: "" if c.goodness is None else c.goodness.p,
    "error_m": lambda c: "" if c.error_m is None else c.error_m,
    "error_sigma_m": lambda c: "" if c.error_m is None else c.error_sigma_m,
    "fill_rate": lambda c: c.fill_rate,
    "z_accuracy": lambda c: "" if c.z_accuracy is None else c.z_accuracy,
    "subpixel_rms_px": lambda c: c.subpixel_rms_px,
    "temporal_sigma_m": lambda c: c.temporal.median_m,
    "still_share": lambda c: c.temporal.still_share,
    "lateral_sigma_px": lambda c: c.lateral_px if c.lateral_readings else "",
    "paper_column_sigma_m": lambda c: c.paper.column_sigma_m,
    # The paper measures it facing the plate only; else the grid's mean is not at the axis.
    "paper_error_m": lambda c: "" if c.cell.angle_deg else c.paper.grid_mean_m - c.cell.distance_m,
    "faults": lambda c: "; ".join(fault.kind for fault in c.faults),
}


# The first line of that table.
COLUMNS = ",".join(_COLUMNS)


def cells_csv(cells: tuple[CellResult, ...]) -> str:
    """Return the table of all cells, with intervals."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for cell in cells:
        values = [fill(cell) for fill in _COLUMNS.values()]
        writer.writerow(f"{v:.6g}" if isinstance(v, float) else v for v in values)
    return text.getvalue()
