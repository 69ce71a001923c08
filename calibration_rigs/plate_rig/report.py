"""The products of a calibration: one HTML file, a table, the calibration file, ROS factors."""

from __future__ import annotations

import io
from dataclasses import dataclass
from math import degrees
from pathlib import Path

import numpy as np

from calibration_rigs.plate_rig import figures
from calibration_rigs.plate_rig.process import PlateResult, worst_held_out
from calibration_rigs.plate_rig.products import (
    COLUMNS,
    ROS_MARK,
    calibration_json,
    cells_csv,
    measured,
    noise_model,
    ros_yaml,
)
from calibration_rigs.plate_rig.sigma_models import SigmaFit
from calibration_rigs.plate_rig.verdict import cell_warnings, verdict
from calibration_rigs.replaced import check_replaced, of_schema, of_table
from mapping.calibration_file import DEPTH_NOISE_SCHEMA
from mapping.files import write_whole
from mapping.output.figures import png_bytes
from mapping.output.pages import picture, render

CALIBRATION_NAME = "calibration.json"
ROS_NAME = "elevation_mapping.yaml"
TABLE_NAME = "cells.csv"
REPORT_NAME = "report.html"
_PICTURES = {
    "Systematic error": (
        figures.bias_figure,
        (
            "Mean reading minus tape, with 95 % intervals, and the fit that the file corrects "
            "(the paper's figure 6)."
        ),
    ),
    "Noise": (
        figures.noise_figure,
        (
            "Standard deviation of a pixel without the sensor's steps, the law with its 95 % "
            "prediction bands, and beside it what the paper's column means give (figures 8 and 10)."
        ),
    ),
    "Deviations": (
        figures.deviation_figure,
        (
            "Readings about the plane (blue), a rounded normal law (black) and the plain normal "
            "law that the paper fits (red, dashed): the steps make the difference (figures 7 "
            "and 9)."
        ),
    ),
    "Quantiles": (figures.qq_figure, "Readings against the rounded normal law: on the diagonal."),
    "Steps": (figures.ratio_figure, "Noise in units of the sensor's depth step."),
    "Residuals": (
        figures.residual_figure,
        (
            "What all plates together are off their planes: distortion of the sensor, or a plate "
            "that is not flat (cf. figure 5)."
        ),
    ),
}


@dataclass(frozen=True, slots=True)
class Summary:
    """A calibration in a few lines, and the files that were written."""

    result: PlateResult
    files: tuple[Path, ...]

    def as_json(self) -> object:
        """Return the calibration's numbers as JSON values."""
        return {
            "verdict": verdict(self.result),
            "cells": len(self.result.manifest.cells),
            "used": len(self.result.used),
            "law": self.result.laws[0].name,
            "held_out_share": min(worst_held_out(self.result), 1e6),
            "bias": [float(value) for value in self.result.bias.coefficients],
            "warnings": self.warnings(),
            "files": [str(path) for path in self.files],
        }

    def describe(self) -> list[str]:
        """Return the verdict and the files."""
        return [*verdict(self.result), *map(str, self.files)]

    def warnings(self) -> list[str]:
        """Return what is wrong with single cells."""
        return cell_warnings(self.result)


def check_products(folder: Path) -> None:
    """Refuse a folder whose calibration, table or ROS factors are not of this rig.

    Raises:
        RigError: a file with such a name is something else, such as the list of the recordings.
        StreamError: they cannot be written.
    """
    of_noise = of_schema(DEPTH_NOISE_SCHEMA)
    check_replaced(folder / CALIBRATION_NAME, "depth noise calibration", of_noise)
    check_replaced(folder / TABLE_NAME, "table of calibrated cells", of_table(COLUMNS))
    check_replaced(folder / ROS_NAME, "file of this rig", lambda text: ROS_MARK.encode() in text)


def write_products(result: PlateResult, folder: Path, *, undistortion: bool) -> list[Path]:
    """Write calibration.json, elevation_mapping.yaml, cells.csv and report.html into a folder.

    Args:
        result: the calibration.
        folder: must exist.
        undistortion: also write undistortion.npz: mean_px, what to subtract from each pixel's
            disparity in pixels of the 640 px wide image (NaN = never seen), cells, and what
            `mapping.undistortion` needs beside it.

    Raises:
        MappingError: a file cannot be written; none of the later ones is then.
    """
    contents = {
        CALIBRATION_NAME: calibration_json(result).encode(),
        ROS_NAME: ros_yaml(result).encode(),
        TABLE_NAME: cells_csv(result.cells).encode(),
        REPORT_NAME: report_html(result).encode(),
    }
    if undistortion:
        packed, rig, camera = io.BytesIO(), result.manifest.rig, result.used[0].camera
        np.savez_compressed(
            packed,
            mean_px=result.distortion.mean_px.astype(np.float32),
            cells=result.distortion.cells,
            disparity_px_m=rig.disparity_px_m(camera.fx_px, camera.width_px),
            model=result.device.model,
            serial=result.device.serial,
        )
        contents["undistortion.npz"] = packed.getvalue()
    for name, content in contents.items():
        write_whole(folder / name, content)
    return [folder / name for name in contents]


def report_html(result: PlateResult) -> str:
    """Return the report as one HTML page that needs no other file."""
    device = f"{result.device.model} {result.device.serial}".strip() or "unknown device"
    return render(
        "calibration_rigs.plate_rig",
        "plate.html",
        title=f"Depth noise of {device}",
        verdict=verdict(result),
        warnings=cell_warnings(result),
        pictures=[
            picture(name, caption, png_bytes(draw(result)))
            for name, (draw, caption) in _PICTURES.items()
        ],
        laws=[
            (
                law.name,
                _parameters(law),
                100.0 * float(np.expm1(law.misfit)),
                100.0 * float(np.expm1(law.held_out)),
            )
            for law in result.laws
        ],
        cells=result.cells,
        degrees=degrees,
        facts=_facts(result),
        sha256=result.sha256,
    )


def _parameters(law: SigmaFit) -> str:
    """Return a law's parameters, with their standard uncertainty where it was drawn."""
    known = np.sqrt(np.diag(law.covariance))
    return ", ".join(
        f"{value:.3g} ± {sigma:.1g}" if sigma > 0.0 else f"{value:.3g}"
        for value, sigma in zip(law.parameters, known, strict=True)
    )


def _facts(result: PlateResult) -> dict[str, str]:
    """Return what the model and its making come to, under the names to print."""
    model, how, box = noise_model(result), measured(result), measured(result).validity
    rig = result.manifest.rig
    area = model.correlation_area_px
    return {
        "device": f"{result.device.model} {result.device.serial or '(no serial number)'}",
        "environment": how.environment,
        "light": _between(box.lux_min, box.lux_max, "lx"),
        "temperature": _between(box.temperature_min_c, box.temperature_max_c, "°C"),
        "plate": f"{rig.plate_width_m:g} m x {rig.plate_height_m:g} m",
        "tape, one sigma": f"{1e3 * rig.tape_sigma_m:g} mm a reading, "
        f"{1e3 * rig.tape_zero_sigma_m:g} mm shared by all",
        "focal length x baseline": f"{how.disparity_px_m:.2f} px m, {rig.disparity_step_px:g} px",
        "frames": f"{how.frames} in {how.cells} cells",
        "independent readings in a cell (median)": f"{how.effective_readings:.0f}",
        "pixels that share one draw": f"{area:.1f}",
        "lateral noise": f"{model.lateral_offset_px:.2f} + {model.lateral_angle_px:.3f} t px",
        "bias": f"{1e3 * model.bias_m:+.2f} mm {1e3 * model.bias_slope:+.2f} mm/m Z "
        f"{1e3 * model.bias_quadratic_per_m:+.2f} mm/m² Z²",
        "scatter of the bias about its fit": f"{result.bias.scatter:.2f} of what is expected",
        "bias at a station left out": f"{1e3 * result.bias.held_out_m:.1f} mm",
    }


def _between(low: float | None, high: float | None, unit: str) -> str:
    if low is None or high is None:
        return "not recorded"
    return f"{low:g} {unit}" if low == high else f"{low:g} to {high:g} {unit}"
