"""Statistics of the lunar presets against what they are made to be, and pictures to look at.

    python benchmarks/terrain.py [--seed N] [--figure FILE.png] [--json FILE]

Sources of the expected values: simulation/terrain/lunar_features.py and rough_ground.py. The
exponents and RMS heights expected are those of the bare ground between craters and rocks, which
is measured apart; craters and rocks add relief at all scales, most at theirs.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from numpy.typing import NDArray

from simulation.terrain.height_grid import HeightGrid
from simulation.terrain.lunar_features import crater_count, rock_count
from simulation.terrain.lunar_terrain import (
    DEFAULT_EXTENT,
    LARGEST_CRATER_M,
    PRESETS,
    LunarTerrain,
    lunar_terrain,
)
from simulation.terrain.rough_ground import (
    COARSE_EXPONENT,
    FINE_EXPONENT,
    expected_rms_height_m,
    rough_ground,
)
from simulation.terrain.terrain_statistics import count_per_m2, terrain_statistics

_DIAMETERS_M = {"craters": (0.08, 0.2, 0.5), "rocks": (0.08, 0.12, 0.2)}
AREA_M2 = (DEFAULT_EXTENT[1] - DEFAULT_EXTENT[0]) * (DEFAULT_EXTENT[3] - DEFAULT_EXTENT[2])


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
    bare: dict[str, HeightGrid] = {}
    rows: list[Row] = []
    for preset in PRESETS:
        start = time.perf_counter()
        terrains[preset] = lunar_terrain(preset, options.seed)
        seconds = time.perf_counter() - start
        rows.append(Row(preset, "seconds for 1001 x 1001 nodes", seconds, 1.0))
        bare[preset] = bare_ground(preset, options.seed, terrains[preset].grid)
        rows.extend(compare(preset, terrains[preset], bare[preset]))
    for row in rows:
        print(f"{row.preset:8} {row.quantity:38} {row.measured:9.4f} {row.expected:9.4f}")
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")
    if options.figure:
        draw(terrains, bare, options.figure)


def bare_ground(preset: str, seed: int, grid: HeightGrid) -> HeightGrid:
    """Return the ground of a terrain before craters, rocks and the level start came onto it."""
    slope_rad = float(np.radians(PRESETS[preset].ground_slope_deg))
    random = np.random.default_rng([seed, 0])  # as `lunar_terrain` draws it
    heights = rough_ground(grid.height_m.shape, grid.spacing_m, slope_rad, random)
    return replace(grid, height_m=heights.astype(np.float32))


def compare(preset: str, terrain: LunarTerrain, bare: HeightGrid) -> Iterator[Row]:
    """Give the statistics of a terrain beside the expected ones."""
    kind = PRESETS[preset]
    found, of_bare = terrain_statistics(terrain.grid), terrain_statistics(bare)
    expected = {0.02: kind.slope_2cm_deg, 1.0: kind.slope_1m_deg}
    for baseline, slope in found.median_slope_rad.items():
        name = f"median slope over {baseline:g} m, deg"
        yield Row(preset, name, float(np.degrees(slope)), expected.get(baseline, np.nan))
    for where, roughness, fine, coarse in (
        ("bare", of_bare, FINE_EXPONENT, COARSE_EXPONENT),
        ("whole", found, np.nan, np.nan),
    ):
        yield Row(preset, f"{where}: Hurst exponent 4-20 cm", roughness.exponent(0.04, 0.2), fine)
        yield Row(preset, f"{where}: Hurst exponent 0.4-2 m", roughness.exponent(0.4, 2.0), coarse)
        for window, rms in roughness.rms_height_m.items():
            name = f"{where}: RMS height in {window:g} m, mm"
            wanted_m = expected_rms_m(preset, window) if where == "bare" else np.nan
            yield Row(preset, name, 1000.0 * rms, 1000.0 * wanted_m)
    for what, sizes_m, wanted in features(preset, terrain):
        for diameter, count in count_per_m2(sizes_m, _DIAMETERS_M[what], AREA_M2).items():
            if wanted(diameter) > 0.0:
                yield Row(preset, f"{what} > {diameter:g} m per m^2", count, wanted(diameter))


def expected_rms_m(preset: str, window_m: float) -> float:
    """Return the RMS height of bare ground in windows."""
    return expected_rms_height_m(window_m, float(np.radians(PRESETS[preset].ground_slope_deg)))


def features(
    preset: str, terrain: LunarTerrain
) -> Iterator[tuple[str, NDArray[np.float64], Callable[[float], float]]]:
    """Give name, diameters and the number per m^2 above a diameter by law: craters, rocks."""
    kind = PRESETS[preset]

    def craters(diameter_m: float) -> float:
        """Return the craters per m^2 above a diameter, by the law."""
        count = crater_count(diameter_m, kind.crater_density)
        return count - crater_count(LARGEST_CRATER_M, kind.crater_density)

    def rocks(diameter_m: float) -> float:
        """Return the rocks per m^2 above a diameter, by the law."""
        if diameter_m >= kind.largest_rock_m:
            return 0.0
        count = rock_count(diameter_m, kind.rock_share)
        return count - rock_count(kind.largest_rock_m, kind.rock_share)

    yield "craters", terrain.craters[:, 2], craters
    yield "rocks", terrain.rocks[:, 2], rocks


def draw(terrains: dict[str, LunarTerrain], bare: dict[str, HeightGrid], path: Path) -> None:
    """Draw shaded relief, slope by baseline, RMS height by window, and counts by size."""
    figure = Figure(figsize=(16.0, 11.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3)
    for ax, (preset, terrain) in zip(axes[0], terrains.items(), strict=True):
        _draw_relief(ax, preset, terrain.grid)
    colours = dict(zip(terrains, ("C0", "C1", "C2"), strict=True))
    slopes, heights, counts = axes[1]
    for preset, terrain in terrains.items():
        kind, style = PRESETS[preset], {"color": colours[preset]}
        found, of_bare = terrain_statistics(terrain.grid), terrain_statistics(bare[preset])
        medians_deg = np.degrees(list(found.median_slope_rad.values()))
        slopes.plot(list(found.median_slope_rad), medians_deg, label=preset, **style)
        slopes.plot([0.02, 1.0], [kind.slope_2cm_deg, kind.slope_1m_deg], "o", **style)
        windows = list(found.rms_height_m)
        rms_mm = [[1000.0 * s.rms_height_m[w] for w in windows] for s in (found, of_bare)]
        heights.plot(windows, rms_mm[0], label=f"{preset}: whole", **style)
        heights.plot(windows, rms_mm[1], "--", label=f"{preset}: bare", **style)
        wanted_mm = [1000.0 * expected_rms_m(preset, window) for window in windows]
        heights.plot(windows, wanted_mm, "o", **style)
        for marker, (what, sizes_m, wanted) in zip("^s", features(preset, terrain), strict=True):
            _draw_counts(counts, f"{preset}: {what}", sizes_m, wanted, marker, colours[preset])
    slopes.set(title="Slope: lines measured, dots wanted", xlabel="baseline [m]")
    slopes.set_ylabel("median slope [deg]")
    title = "Roughness, with (whole) and without (bare) craters and rocks\ndots: wanted of the bare"
    heights.set(title=title, xlabel="edge of the window [m]", ylabel="RMS height [mm]")
    counts.set(title="Craters and rocks: marks counted, lines by law", xlabel="diameter D [m]")
    counts.set_ylabel("number larger than D, per m²")
    for ax in axes[1]:
        ax.set(xscale="log", yscale="log")
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_formatter("{x:g}")
        ax.grid(which="both", alpha=0.25)
        ax.legend(fontsize="small")
    slopes.yaxis.set_minor_formatter("{x:g}")
    figure.savefig(path, dpi=90)


def _draw_relief(ax: Axes, preset: str, grid: HeightGrid) -> None:
    light = LightSource(azdeg=315, altdeg=20)
    shade = light.hillshade(grid.height_m[::-1], dx=grid.spacing_m, dy=grid.spacing_m)
    ax.imshow(shade, cmap="gray", extent=grid.extent)
    ax.set(title=f"{preset}, lit from the upper left", xlabel="x [m]", ylabel="y [m]")


def _draw_counts(
    ax: Axes,
    label: str,
    sizes_m: NDArray[np.float64],
    wanted: Callable[[float], float],
    marker: str,
    colour: str,
) -> None:
    """Draw how many are larger, counted and by law, down to one on the whole terrain."""
    diameters_m = np.geomspace(0.08, 2.0, 60)
    law = np.array([wanted(diameter) for diameter in diameters_m])
    ax.plot(diameters_m[law * AREA_M2 > 1.0], law[law * AREA_M2 > 1.0], color=colour)
    marks_m = [d for d in (0.08, 0.12, 0.2, 0.3, 0.5, 0.8, 1.2) if (sizes_m > d).any()]
    found = count_per_m2(sizes_m, marks_m, AREA_M2)
    ax.plot(list(found), list(found.values()), marker, color=colour, label=label)


if __name__ == "__main__":
    main()
