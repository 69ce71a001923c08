"""How often the 95 % interval of sigma holds the truth, on pixels alone: thousands of draws.

    python benchmarks/plate_interval.py [--repeats N] [--json FILE]

`benchmarks/plate_rig.py coverage` does the same with whole cells, some hundred times slower.
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where mapping.py would hide the package `mapping`.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json

import numpy as np
from numpy.typing import NDArray

from calibration_rigs.plate_rig.quantised import count_readings, fit_spread
from calibration_rigs.plate_rig.spread import patches_of

Float64Array = NDArray[np.float64]

_STEP_PER_M = 0.125 / 43.5  # of 1 / distance, a Kinect V1's
_FRAMES = 10

# Width and height in pixels, distance in m, steps per pixel along u and v, noise before the steps
# in steps, noise behind them in mm.
PLATES = {
    "facing, 1 m": (88, 88, 1.003, 0.0004, 0.0003, 0.448, 1.0),
    "facing, 3 m": (88, 88, 3.001, 0.0002, 0.0001, 0.448, 1.0),
    "half a turn": (88, 88, 1.81, 0.006, 0.002, 0.32, 0.8),
    "tilted": (88, 88, 1.4, 0.09, 0.0, 0.448, 1.0),
    "steep, narrow": (14, 88, 2.2, 0.2, 0.0, 0.448, 2.0),
    "just told": (88, 88, 3.0, 0.03, 0.002, 0.301, 0.5),
}


def main() -> None:
    """Print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=2000)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    error = 100.0 * np.sqrt(0.95 * 0.05 / options.repeats)
    rows = {}
    print(f"{'plate':>14} {'inside':>8} {'bias of sigma':>14} {'half width':>11}")
    for name, plate in PLATES.items():
        inside, bias, width = np.mean([_draw(plate, k) for k in range(options.repeats)], axis=0)
        rows[name] = {"inside": inside, "bias": bias, "half_width": width}
        print(
            f"{name:>14} {100 * inside:7.2f}% {100 * bias:13.3f}% {100 * width:10.2f}%", flush=True
        )
    whole = float(np.mean([row["inside"] for row in rows.values()]))
    print(f"all: {100 * whole:.2f} %; a row is known to +- {error:.2f} %")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=2) + "\n")


def _draw(plate: tuple[int, int, float, float, float, float, float], seed: int) -> Float64Array:
    """Return whether the interval holds the truth, the log error of sigma, and its half width."""
    width, height, z_m, along_u, along_v, before, behind_mm = plate
    random = np.random.default_rng(seed)
    v, u = (axis.ravel() for axis in np.mgrid[:height, :width].astype(np.float64))
    plane = 1.0 / (z_m * _STEP_PER_M) + along_u * (u - 0.5 * width) + along_v * (v - 0.5 * height)
    noise = random.standard_normal((2, _FRAMES, u.size))
    reading_mm = 1e3 / (np.rint(plane + before * noise[0]) * _STEP_PER_M) + behind_mm * noise[1]
    spread_mm = np.rint(reading_mm) + random.uniform(-0.5, 0.5, reading_mm.shape)
    step_mm = 1e3 * z_m**2 * _STEP_PER_M
    rounding = np.sqrt(2.0 / 12.0) / step_mm
    table = count_readings(plane, 1e3 / spread_mm / _STEP_PER_M, patches_of(u, v), rounding)
    fit = fit_spread(table)
    truth = np.hypot(before, behind_mm / step_mm)
    inside = fit.low <= truth <= fit.high
    return np.array([inside, np.log(fit.sigma / truth), np.log(fit.high / fit.sigma)])


if __name__ == "__main__":
    main()
