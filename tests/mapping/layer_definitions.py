"""The layers as they are defined, in plain numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.ground.layers import LayerSettings

NAN = np.nan


def by_definition(map_: ElevationMap, chosen: LayerSettings) -> dict[str, NDArray[np.float64]]:
    """Return the layers of a map by name, cell by cell, with an eigenvalue solver."""
    rows, columns = map_.state.shape
    names = ("slope_rad", "roughness_m", "slope_sigma_rad", "roughness_noise_m", "step_m")
    out = {name: np.full((rows, columns), NAN) for name in (*names, "traversability")}
    confirmed = np.isin(map_.state, (CellState.MEASURED, CellState.UNCERTAIN))
    j, i = np.meshgrid(np.arange(columns), np.arange(rows))
    noise_m2 = map_.independent_m2.astype(float)
    local_m2 = noise_m2 + map_.relief_m2

    def around(row: int, column: int, radius_m: float) -> tuple[NDArray[np.bool_], int]:
        near = np.hypot(i - row, j - column) * map_.resolution_m <= radius_m + 1e-9
        # Cells of the disc, had the map no border.
        reach = np.arange(-9, 10)
        whole = np.hypot(*np.meshgrid(reach, reach)) * map_.resolution_m <= radius_m + 1e-9
        return near & confirmed, int(np.ceil(chosen.support_share * whole.sum()))

    for row, column in np.argwhere(confirmed):
        use, least = around(row, column, chosen.step_radius_m)
        if use.sum() >= max(least, 2):
            out["step_m"][row, column] = np.ptp(map_.elevation_m[use].astype(float))
        use, least = around(row, column, chosen.plane_radius_m)
        n = use.sum()
        if n < max(least, 4):
            continue
        points = np.stack(
            [j[use] * map_.resolution_m, i[use] * map_.resolution_m, map_.elevation_m[use]]
        ).astype(float)
        points -= points.mean(axis=1, keepdims=True)
        values, vectors = np.linalg.eigh(points @ points.T)
        cosine = abs(vectors[2, 0])
        noise, local = noise_m2[use].mean(), local_m2[use].mean()
        across = np.linalg.eigvalsh(points[:2] @ points[:2].T)[0]
        out["slope_rad"][row, column] = np.arccos(min(cosine, 1.0))
        out["roughness_m"][row, column] = np.sqrt(max(values[0], 0.0) / (n - 1))
        out["slope_sigma_rad"][row, column] = np.sqrt(local / across) * cosine**2
        out["roughness_noise_m"][row, column] = cosine * np.sqrt(noise * (n - 3) / (n - 1))
    steps = out["step_m"]
    supported = np.full_like(steps, NAN)
    for row, column in np.argwhere(np.isfinite(steps)):
        near = steps[around(row, column, chosen.step_radius_m)[0]]
        share = np.count_nonzero(near > chosen.critical_step_m) / chosen.step_cells
        supported[row, column] = min(1.0, share) * np.nanmax(near)
    scores = [
        np.clip(1.0 - layer / critical, 0.0, None)
        for layer, critical in (
            (out["slope_rad"], chosen.critical_slope_rad),
            (out["roughness_m"], chosen.critical_roughness_m),
            (supported, chosen.critical_step_m),
        )
    ]
    combine = np.mean if chosen.combination == "mean" else np.min
    out["traversability"] = combine(scores, axis=0)
    return out
