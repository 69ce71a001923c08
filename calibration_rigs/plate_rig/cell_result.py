"""What one cell came to: sigma, bias and everything else that is said of it."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees

from calibration_rigs.plate_rig.faults import Fault
from calibration_rigs.plate_rig.goodness import Goodness
from calibration_rigs.plate_rig.manifest import CellEntry
from calibration_rigs.plate_rig.metrics import PaperNumbers, TemporalSpread
from calibration_rigs.plate_rig.quantised import QuantisedSpread
from calibration_rigs.plate_rig.spread import Deviations
from drivers.samples import CameraIntrinsics
from mapping.calibration_file import DeviceIdentity


@dataclass(frozen=True, slots=True)
class CellResult:
    """What one cell came to. Lengths in metres, angles in radians.

    Attributes:
        cell: what was asked for and read off the tape.
        device, camera, sha256: who measured, and in which bytes.
        frames, pixels: used; pixels well on the plate.
        z_m, incidence_rad: mean of the readings that sigma was made of.
        turn_rad, tip_rad, roll_rad: of the plate, from the plane and its side edges.
        step_m: depth step at z_m.
        spread: of the readings, in steps.
        goodness: chi-square over the steps; None when too few steps occur.
        plain_sigma_m: standard deviation of the same readings about the plane, steps included:
            the plane RMS.
        sheppard_sigma_m: the same less that of steps of uniform phase.
        error_m: reading minus tape at the plate's middle; None when the tape was refused.
        error_sigma_m: its standard deviation, without what all cells share.
        fill_rate: share of the plate's pixels that read.
        z_accuracy: median of (reading - truth) / truth; None without tape.
        subpixel_rms_px: plane RMS as disparity.
        temporal: spread in time.
        lateral_px, lateral_readings: spread of the side edges in pixels of the 640 px wide image.
        correlation_area_px: pixels of the 640 px wide image that share one draw.
        paper: the paper's own numbers.
        deviations: histogram of the readings about the plane.
        faults: what is wrong with the cell.
    """

    cell: CellEntry
    device: DeviceIdentity
    camera: CameraIntrinsics
    sha256: str
    frames: int
    pixels: int
    z_m: float
    incidence_rad: float
    turn_rad: float
    tip_rad: float
    roll_rad: float
    step_m: float
    spread: QuantisedSpread
    goodness: Goodness | None
    plain_sigma_m: float
    sheppard_sigma_m: float
    error_m: float | None
    error_sigma_m: float
    fill_rate: float
    z_accuracy: float | None
    subpixel_rms_px: float
    temporal: TemporalSpread
    lateral_px: float
    lateral_readings: int
    correlation_area_px: float
    paper: PaperNumbers
    deviations: Deviations
    faults: tuple[Fault, ...]

    @property
    def sigma_m(self) -> float:
        """Spread without the steps; an upper bound when `spread.is_below`."""
        return self.spread.sigma * self.step_m

    @property
    def is_used(self) -> bool:
        """Whether the cell takes part in the fits."""
        return not any(fault.excludes for fault in self.faults)


def label(result: CellResult) -> str:
    """Return a cell's distance and angle as they were measured."""
    return f"{result.z_m:.2f} m, {degrees(result.incidence_rad):.0f} deg"
