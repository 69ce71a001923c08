"""Speed of the derived layers on one core, beside scipy and numpy in the same run.

    python benchmarks/layers.py [--repeats N] [--json FILE]

The map is rolling ground with noise and holes, 300 x 300 cells. Time is CPU time of the thread,
median over the repeats. The yardstick computes the same planes, slopes, roughnesses and steps
with scipy's compiled filters and numpy's batched eigenvalue solver; both are compared first.
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where mapping.py would hide the package `mapping`.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.ground.layers import LayerSettings, derive, disc

Float64Array = NDArray[np.float64]
_CELLS = 300
_HOLES = 0.05


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table."""

    cell_m: float
    disc_cells: int
    derive_ms: float
    mcell_s: float
    scipy_ms: float
    times_scipy: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=50)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    rows = [measure(cell_m, options.repeats) for cell_m in (0.02, 0.04)]
    print(
        f"{'cell':>6} {'in disc':>7} {'all layers':>11} {'Mcell/s':>8} {'scipy':>10} {'faster':>7}"
    )
    for r in rows:
        print(
            f"{r.cell_m:>5.2f}m {r.disc_cells:>7} {r.derive_ms:>8.2f} ms {r.mcell_s:>8.1f} "
            f"{r.scipy_ms:>7.0f} ms {r.times_scipy:>6.0f}x"
        )
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


def measure(cell_m: float, repeats: int) -> Row:
    """Return the times for cells of that size."""
    map_, settings = _ground(cell_m), LayerSettings()
    ours, peer = derive(map_), _scipy_layers(map_, settings)
    for name, layer in zip(("slope_rad", "roughness_m", "step_m"), peer, strict=True):
        np.testing.assert_allclose(getattr(ours, name), layer, rtol=1e-3, atol=1e-5, err_msg=name)
    derive_s = _median_s(lambda: derive(map_), repeats)
    scipy_s = _median_s(lambda: _scipy_layers(map_, settings), 3)
    return Row(
        cell_m=cell_m,
        disc_cells=int(_footprint(settings.plane_radius_m, cell_m).sum()),
        derive_ms=1e3 * derive_s,
        mcell_s=map_.state.size / derive_s / 1e6,
        scipy_ms=1e3 * scipy_s,
        times_scipy=scipy_s / derive_s,
    )


def _ground(cell_m: float) -> ElevationMap:
    random = np.random.default_rng(1)
    centres_m = (np.arange(_CELLS, dtype=np.float64) + 0.5) * cell_m
    x, y = np.meshgrid(centres_m, centres_m)
    height = 0.1 * np.sin(3.0 * x) * np.cos(4.0 * y) + 0.002 * random.standard_normal(x.shape)
    seen = random.random(x.shape) >= _HOLES
    variance = np.where(seen, 4e-6, np.nan).astype(np.float32)
    count = seen.astype(np.uint32)
    return ElevationMap(
        resolution_m=cell_m,
        x_m=centres_m,
        y_m=centres_m,
        elevation_m=np.where(seen, height, np.nan).astype(np.float32),
        variance_m2=variance,
        independent_m2=variance,
        systematic_m2=0 * variance,
        relief_m2=0 * variance,
        pose_m2=0 * variance,
        horizontal_m2=0 * variance,
        horizontal_xx_m2=0 * variance + np.float32(0.25 * cell_m**2),
        horizontal_xy_m2=0 * variance,
        horizontal_yy_m2=0 * variance + np.float32(0.25 * cell_m**2),
        frames=count,
        pixels=count,
        last_seen_ns=seen.astype(np.int64),
        state=np.where(seen, CellState.MEASURED, CellState.UNKNOWN).astype(np.uint8),
    )


def _median_s(work: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        work()
        times.append(time.thread_time() - start)
    return float(np.median(times))


def _footprint(radius_m: float, cell_m: float) -> NDArray[np.bool_]:
    half = disc(radius_m, cell_m)
    offset = np.arange(1 - half.size, half.size)
    return np.abs(offset) <= half[np.abs(offset)][:, np.newaxis]


def _scipy_layers(
    map_: ElevationMap, settings: LayerSettings
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Slope, roughness and step, as one would write them with scipy."""
    seen = np.isfinite(map_.elevation_m)
    ones = seen.astype(float)
    z = np.where(seen, map_.elevation_m / map_.resolution_m, 0.0).astype(float)
    shape = _footprint(settings.plane_radius_m, map_.resolution_m)
    y, x = np.indices(shape.shape) - shape.shape[0] // 2

    def total(layer: Float64Array, weight: NDArray[np.integer] | int = 1) -> Float64Array:
        """Return the weighted sum of a layer over the footprint around each cell."""
        sums: Float64Array = ndimage.correlate(layer, shape * weight * 1.0, mode="constant")
        return sums

    n = np.where(seen, total(ones), 0.0)
    use = n >= max(4, np.ceil(settings.support_share * shape.sum()))
    mean = np.stack([total(ones, x), total(ones, y), total(z)])[:, use] / n[use]
    moments = (
        *(total(ones, x * x), total(ones, x * y), total(z, x)),
        *(total(ones, x * y), total(ones, y * y), total(z, y)),
        *(total(z, x), total(z, y), total(z * z)),
    )
    matrix = np.stack([moment[use] for moment in moments], -1).reshape(-1, 3, 3)
    matrix -= n[use][:, np.newaxis, np.newaxis] * np.einsum("in,jn->nij", mean, mean)
    values, vectors = np.linalg.eigh(matrix)
    slope, roughness, step = (np.full(seen.shape, np.nan) for _ in range(3))
    slope[use] = np.arccos(np.minimum(np.abs(vectors[:, 2, 0]), 1.0))
    roughness[use] = map_.resolution_m * np.sqrt(np.maximum(values[:, 0], 0.0) / (n[use] - 1.0))
    near = _footprint(settings.step_radius_m, map_.resolution_m)
    high, low = (np.where(seen, map_.elevation_m, end) for end in (-np.inf, np.inf))
    top = ndimage.maximum_filter(high, footprint=near, mode="constant", cval=-np.inf)
    bottom = ndimage.minimum_filter(low, footprint=near, mode="constant", cval=np.inf)
    cells = ndimage.correlate(ones, near * 1.0, mode="constant")
    enough = seen & (cells >= max(2, np.ceil(settings.support_share * near.sum())))
    step[enough] = (top - bottom)[enough]
    return slope, roughness, step


if __name__ == "__main__":
    main()
