"""Checks and speed of the simulated vehicle, as tables.

    python benchmarks/simulation.py [--seconds S] [--json FILE]

Speed is simulated time over CPU time of the drive alone, kernels compiled before. At rest, the
vehicle stands on level ground, on a slope of 12 degrees and on waves; "jitter" is the RMS of the
specific force's change, "creep" the mean velocity. Driving, "slip" is 1 - way / way of the rims,
and "track" the effective track over the geometric one, from true yaw and wheel angles.
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where this very file would hide the package.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from simulation.motion import Motion
from simulation.terrain.height_grid import HeightGrid
from simulation.vehicle import jackal
from simulation.vehicle.drive_commands import Arc, DriveCommands, Line, SCurve, StopAndGo
from simulation.vehicle.vehicle import Contact, Vehicle
from simulation.vehicle.vehicle_run import DriveOptions, simulate_vehicle

Float64Array = NDArray[np.float64]
_HALF_SIZE_M = 8.0
_SPACING_M = 0.02
_REST_S = 2.0


@dataclass(frozen=True, slots=True)
class Row:
    """One drive."""

    ground: str
    contact: Contact
    drive: str
    jitter_m_s2: float
    creep_mm_s: float
    creep_rad_s: float
    acceleration_correlation: float
    slip: float
    track_ratio: float
    vibration_m_s2: float
    real_time_factor: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="length of each drive")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    grounds = {"level": _ground(0.0, 0.0), "12 deg": _ground(12.0, 0.0), "waves": _ground(0.0, 1.0)}
    drives: dict[str, DriveCommands] = {
        "line": Line(0.3),
        "arc 1 m": Arc(0.3, 1.0),
        "S-curve": SCurve(0.3),
        "stop and go": StopAndGo(0.3),
    }
    contacts: tuple[Contact, ...] = ("soil", "native")
    for contact in contacts:
        simulate_vehicle(grounds["level"], drives["line"], 1.0, 0, _options(contact, 0.5))
    print(f"mass {Vehicle(grounds['level']).mass_kg:.3f} kg")
    rows = [
        measure(ground, grounds[ground], contact, drive, drives[drive], options.seconds)
        for contact in contacts
        for ground in grounds
        for drive in drives
    ]
    _print(rows)
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


def _options(contact: Contact, rest_s: float = _REST_S) -> DriveOptions:
    return DriveOptions(contact=contact, rest_s=rest_s)


def _ground(degrees: float, waves: float) -> HeightGrid:
    """Return a plane that rises along x, with waves of 0.1 to 2 m on top."""
    random = np.random.default_rng(1)
    axis = _SPACING_M * np.arange(round(2 * _HALF_SIZE_M / _SPACING_M) + 1) - _HALF_SIZE_M
    x, y = np.meshgrid(axis, axis)
    heights = np.tan(np.radians(degrees)) * x
    for _ in range(40 if waves else 0):
        length, direction = np.exp(random.uniform(np.log(0.1), np.log(2.0))), random.uniform(0, 7)
        along = (np.cos(direction) * x + np.sin(direction) * y) / length
        heights += waves * 0.006 * length**0.5 * np.sin(2 * np.pi * along + random.uniform(0, 7))
    return HeightGrid(-_HALF_SIZE_M, -_HALF_SIZE_M, _SPACING_M, heights.astype(np.float32))


def measure(
    ground: str, grid: HeightGrid, contact: Contact, drive: str, commands: DriveCommands, s: float
) -> Row:
    """Return the figures of one drive of s seconds."""
    start = time.process_time()
    motion = simulate_vehicle(grid, commands, s, 1, _options(contact)).motion
    cpu_s = time.process_time() - start
    still = slice(0, round(_REST_S * 1000))
    moved = motion.position_m[still.stop] - motion.position_m[0]
    moving = slice(still.stop + 1000, None)
    return Row(
        ground=ground,
        contact=contact,
        drive=drive,
        jitter_m_s2=float(np.sqrt(np.var(motion.acceleration_m_s2[still], axis=0).sum())),
        creep_mm_s=1000.0 * float(np.linalg.norm(moved)) / _REST_S,
        creep_rad_s=float(np.abs(motion.body_rate_rad_s[still]).max()),
        acceleration_correlation=_correlation(motion, moving),
        slip=_slip(motion, moving),
        track_ratio=_track_ratio(motion, moving),
        vibration_m_s2=float(np.sqrt(np.var(motion.acceleration_m_s2[moving], axis=0).sum())),
        real_time_factor=s / cpu_s,
    )


def _correlation(motion: Motion, moving: slice) -> float:
    """Return the lowest correlation of an axis: felt acceleration with d/dt of the velocity."""
    options = DriveOptions()
    rotation = Rotation.from_quat(motion.quat_wxyz.copy(), scalar_first=True)
    turning = np.cross(motion.body_rate_rad_s, options.accelerometer.position_m)
    velocity = motion.velocity_m_s + rotation.apply(turning)
    derivative = np.diff(velocity, axis=0)[moving] * 1000.0
    felt = rotation[1:].apply(motion.acceleration_m_s2[1:].copy())[moving]
    return min(float(np.corrcoef(felt[:, i], derivative[:, i])[0, 1]) for i in range(3))


def _slip(motion: Motion, moving: slice) -> float:
    way = np.linalg.norm(motion.velocity_m_s[moving], axis=1).sum()
    rims = np.abs(motion.wheel_rate_rad_s[moving].mean(axis=1)).sum() * jackal.WHEEL_RADIUS_M
    return 1.0 - float(way / rims)


def _track_ratio(motion: Motion, moving: slice) -> float:
    """Return rims' difference per yaw rate, over the track; waves disturb only the yaw rate."""
    rims = motion.wheel_rate_rad_s[moving] * jackal.WHEEL_RADIUS_M
    difference = rims[:, 2:].mean(axis=1) - rims[:, :2].mean(axis=1)
    yaw_rate = motion.body_rate_rad_s[moving, 2]
    if np.abs(motion.command[moving, 1]).max() == 0.0:
        return float("nan")
    return float(difference @ difference / (difference @ yaw_rate)) / jackal.TRACK_M


def _print(rows: list[Row]) -> None:
    print(
        f"{'ground':>7} {'contact':>7} {'drive':>12} {'jitter':>9} {'creep':>9} {'turning':>9} "
        f"{'corr':>7} {'slip':>7} {'track':>6} {'vibration':>9} {'faster':>7}"
    )
    print(
        f"{'':>28} {'m/s^2':>9} {'mm/s':>9} {'rad/s':>9} {'':>7} {'':>7} {'':>6} {'m/s^2':>9} "
        f"{'':>7}"
    )
    for r in rows:
        print(
            f"{r.ground:>7} {r.contact:>7} {r.drive:>12} {r.jitter_m_s2:>9.1e} "
            f"{r.creep_mm_s:>9.1e} {r.creep_rad_s:>9.1e} {r.acceleration_correlation:>7.4f} "
            f"{r.slip:>7.1%} {r.track_ratio:>6.2f} {r.vibration_m_s2:>9.2f} "
            f"{r.real_time_factor:>6.1f}x"
        )


if __name__ == "__main__":
    main()
