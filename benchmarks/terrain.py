"""Statistics of the lunar presets against what they are made to be, and pictures to look at.

    python benchmarks/terrain.py [--seed N] [--figure FILE.png] [--json FILE]

Sources of the expected values: simulation/terrain/lunar_features.py and rough_ground.py. The
exponents and RMS heights expected are those of the ground between craters and rocks, which add
relief at all scales, most at theirs.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from simulation.terrain.lunar_features import crater_count, rock_count
from simulation.terrain.lunar_terrain import (
    DEFAULT_EXTENT,
    LARGEST_CRATER_M,
    PRESETS,
    LunarTerrain,
    lunar_terrain,
)
from simulation.terrain.rough_ground import COARSE_EXPONENT, FINE_EXPONENT, expected_rms_height_m
from simulation.terrain.terrain_statistics import count_per_m2, terrain_statistics


@dataclass(frozen=True, slots=True)
class Row:
    """One comparison; expected is NaN where nothing is published for the scale."""

    preset: str
    quantity: str
    measured: float
    expected: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--figure", type=Path, metavar="FILE")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    lunar_terrain("smooth", 0, extent=(0.0, 1.0, 0.0, 1.0))  # compiles
    terrains: dict[str, LunarTerrain] = {}
    rows: list[Row] = []
    for preset in PRESETS:
        start = time.perf_counter()
        terrains[preset] = lunar_terrain(preset, options.seed)
        seconds = time.perf_counter() - start
        rows.append(Row(preset, "seconds for 1001 x 1001 nodes", seconds, 1.0))
        rows.extend(compare(preset, terrains[preset]))
    for row in rows:
        print(f"{row.preset:8} {row.quantity:38} {row.measured:9.4f} {row.expected:9.4f}")
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")
    if options.figure:
        draw(terrains, options.figure)


def compare(preset: str, terrain: LunarTerrain) -> Iterator[Row]:
    """Give the statistics of a terrain beside the expected ones."""
    kind = PRESETS[preset]
    found = terrain_statistics(terrain.grid)
    expected = {0.02: kind.slope_2cm_deg, 1.0: kind.slope_1m_deg}
    for baseline, slope in found.median_slope_rad.items():
        name = f"median slope over {baseline:g} m, deg"
        yield Row(preset, name, float(np.degrees(slope)), expected.get(baseline, np.nan))
    yield Row(preset, "Hurst exponent 4-20 cm", found.exponent(0.04, 0.2), FINE_EXPONENT)
    yield Row(preset, "Hurst exponent 0.4-2 m", found.exponent(0.4, 2.0), COARSE_EXPONENT)
    slope = np.radians(kind.ground_slope_deg)
    for window, rms in found.rms_height_m.items():
        name = f"RMS height in {window:g} m windows, mm"
        yield Row(preset, name, 1000.0 * rms, 1000.0 * expected_rms_height_m(window, slope))
    x_min, x_max, y_min, y_max = DEFAULT_EXTENT
    area = (x_max - x_min) * (y_max - y_min)
    above = (0.08, 0.2, 0.5)
    for diameter, count in count_per_m2(terrain.craters[:, 2], above, area).items():
        wanted = crater_count(diameter, kind.crater_density)
        wanted -= crater_count(LARGEST_CRATER_M, kind.crater_density)
        yield Row(preset, f"craters > {diameter:g} m per m^2", count, wanted)
    above = (0.08, 0.12, 0.2)
    for diameter, count in count_per_m2(terrain.rocks[:, 2], above, area).items():
        if diameter < kind.largest_rock_m:
            wanted = rock_count(diameter, kind.rock_share)
            wanted -= rock_count(kind.largest_rock_m, kind.rock_share)
            yield Row(preset, f"rocks > {diameter:g} m per m^2", count, wanted)


def draw(terrains: dict[str, LunarTerrain], path: Path) -> None:
    """Draw shaded relief and the slope by baseline."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.colors import LightSource

    figure, axes = plt.subplots(2, 2, figsize=(13, 13), layout="constrained")
    for ax, (preset, terrain) in zip(axes.flat, terrains.items(), strict=False):
        grid = terrain.grid
        light = LightSource(azdeg=315, altdeg=20)
        north_up = grid.height_m[::-1]
        shade = light.hillshade(north_up, dx=grid.spacing_m, dy=grid.spacing_m)
        ax.imshow(shade, cmap="gray", extent=grid.extent)
        ax.set(title=preset, xlabel="x, m", ylabel="y, m")
    ax = axes[1, 1]
    for preset, terrain in terrains.items():
        slopes = terrain_statistics(terrain.grid).median_slope_rad
        (line,) = ax.loglog(list(slopes), np.degrees(list(slopes.values())), label=preset)
        kind = PRESETS[preset]
        ax.plot([0.02, 1.0], [kind.slope_2cm_deg, kind.slope_1m_deg], "o", color=line.get_color())
    ax.set(xlabel="baseline, m", ylabel="median slope, deg", title="lines measured, dots wanted")
    ax.legend()
    figure.savefig(path, dpi=80)


if __name__ == "__main__":
    main()
