"""Layers that follow from the heights: normal, slope, roughness, step height, traversability.

They are computed from confirmed cells only and hold for confirmed cells only. A plane that is
best in the sense of orthogonal distances is laid through the cells of a disc around each cell:

- slope: angle between the plane's normal and the vertical; `slope_sigma_rad`: what errors that
  differ from cell to cell (independent and relief) make of it,
  sqrt(mean variance / smallest horizontal spread) cos^2(slope).
- roughness: sqrt(sum of squared distances from the plane / (n - 1)); `roughness_noise_m`: what
  the sensor's noise (independent) alone would make of level ground,
  sqrt(mean variance (n - 3) / (n - 1)) cos(slope). Relief is the ground's own and no noise. A
  roughness that is not clearly above `roughness_noise_m` says nothing of the terrain.
- step: largest minus smallest height in a second disc; a slope makes one too.
- traversability: see `LayerSettings`.

Errors that neighbours share, such as a tilt of the whole map, are not in these layers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from mapping.cells.elevation_map import ElevationMap
from mapping.errors import MappingError
from mapping.ground.layer_kernels import Cells, PlaneLayers, plane_layers
from mapping.ground.step_kernels import step_heights, supported_steps
from mapping.judging.evaluation import CONFIRMED

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Combination = Literal["worst", "mean"]

# A plane through three cells leaves nothing to judge it by.
_PLANE_CELLS_MIN = 4
_STEP_CELLS_MIN = 2
# Cell centres on the rim of a disc belong to it, whatever rounding says.
_RIM = 1.0 + 1e-9


@dataclass(frozen=True, slots=True)
class LayerSettings:
    """How the layers are computed.

    Traversability combines three scores between 0 and 1, each 1 - value / critical, and 0 beyond:
    slope, roughness, and the supported step: the largest step within `step_radius_m`, times
    min(1, number of steps above critical there / step_cells). So steps below the critical one do
    not count, and a single bad cell hardly does. The critical values are a vehicle's own.

    Attributes:
        plane_radius_m: disc for normal, slope and roughness; at least the four neighbours.
        step_radius_m: disc for steps, and for their support.
        support_share: a disc with a smaller share of confirmed cells gives NaN; a corner of the
            map, with more than a quarter of a disc, passes.
        critical_slope_rad, critical_roughness_m, critical_step_m: the vehicle's limits.
        step_cells: see above.
        combination: "worst" takes the smallest of the three scores, "mean" their mean, which
            lets a level surface make up for a wall.
    """

    plane_radius_m: float = 0.1
    step_radius_m: float = 0.06
    support_share: float = 0.3
    critical_slope_rad: float = 1.0
    critical_roughness_m: float = 0.05
    critical_step_m: float = 0.12
    step_cells: int = 4
    combination: Combination = "worst"

    def __post_init__(self) -> None:
        """Refuse values that no layer can be made with."""
        for name in self.__dataclass_fields__.keys() - {"combination"}:
            if not 0.0 < getattr(self, name) < math.inf:
                raise MappingError(f"{name} is {getattr(self, name)}; expected a number above 0")
        if self.support_share > 1.0:
            raise MappingError(f"support_share is {self.support_share}; expected at most 1")
        if self.combination not in get_args(Combination):
            raise MappingError(f"combination is {self.combination!r}; expected worst or mean")


@dataclass(frozen=True, slots=True)
class DerivedLayers:
    """Layers beside a map's own, of its shape, NaN where there is too little support.

    Attributes:
        normal_x, normal_y, normal_z: unit normal, pointing up. Where the cells form a line
            upwards and no plane, such as a pole, z is 0 and x and y are NaN.
        slope_rad: angle between surface and horizontal, 0 to pi/2.
        slope_sigma_rad: standard deviation of the slope from errors of single cells.
        roughness_m: standard deviation of the distances from the plane.
        roughness_noise_m: the part of it that the sensor's noise is expected to make.
        step_m: range of heights in the step disc.
        supported_step_m: the step that traversability judges; see `LayerSettings`.
        traversability: 0 = beyond a limit, 1 = level, smooth, no step.
    """

    normal_x: Float32Array
    normal_y: Float32Array
    normal_z: Float32Array
    slope_rad: Float32Array
    slope_sigma_rad: Float32Array
    roughness_m: Float32Array
    roughness_noise_m: Float32Array
    step_m: Float32Array
    supported_step_m: Float32Array
    traversability: Float32Array


def derive(map_: ElevationMap, settings: LayerSettings | None = None) -> DerivedLayers:
    """Return the layers of a map; the same map gives the same bits."""
    settings = settings or LayerSettings()
    confirmed = np.isfinite(map_.elevation_m)
    confirmed &= (map_.state == CONFIRMED[0]) | (map_.state == CONFIRMED[1])
    planes = _planes(map_, confirmed, settings)
    slope_rad = _slope_rad(planes)
    step_m, supported_m = _steps(map_, confirmed, settings)
    scores = (
        score(slope_rad, settings.critical_slope_rad),
        score(planes.roughness_m, settings.critical_roughness_m),
        score(supported_m, settings.critical_step_m),
    )
    return DerivedLayers(
        slope_rad=slope_rad,
        step_m=step_m,
        supported_step_m=supported_m,
        traversability=_combined(scores, settings.combination),
        **planes._asdict(),
    )


def disc(radius_m: float, edge_m: float) -> NDArray[np.int64]:
    """Return how far a disc reaches to the sides, in cells, in the rows 0, 1, ... from its centre.

    It holds the cells whose centres are within the radius, at least the four neighbours.
    """
    radius = max(radius_m / edge_m, 1.0) * _RIM
    rows = np.arange(int(radius) + 1)
    half: NDArray[np.int64] = np.sqrt(radius**2 - rows**2).astype(np.int64)
    return half


def _cells_min(half: NDArray[np.int64], share: float, least: int) -> int:
    widths = 2 * half + 1
    cells = int(2 * widths.sum() - widths[0])
    return max(least, math.ceil(share * cells - 1e-9))


def _planes(map_: ElevationMap, confirmed: BoolArray, settings: LayerSettings) -> PlaneLayers:
    half = disc(settings.plane_radius_m, map_.resolution_m)
    out = PlaneLayers(*(np.empty(map_.state.shape, np.float32) for _ in PlaneLayers._fields))
    cells = Cells(
        use=confirmed,
        height_m=map_.elevation_m,
        noise_m2=map_.independent_m2,
        local_m2=map_.independent_m2 + map_.relief_m2,
        middle_m=float(map_.elevation_m[confirmed].mean(dtype=np.float64))
        if confirmed.any()
        else 0.0,
        edge_m=map_.resolution_m,
    )
    plane_layers(cells, half, _cells_min(half, settings.support_share, _PLANE_CELLS_MIN), out)
    return out


def _slope_rad(planes: PlaneLayers) -> Float32Array:
    level = np.sqrt(np.square(planes.normal_x) + np.square(planes.normal_y))
    slope: Float32Array = np.arctan2(level, planes.normal_z)
    slope[planes.normal_z == 0.0] = 0.5 * np.pi
    return slope


def _steps(
    map_: ElevationMap, confirmed: BoolArray, settings: LayerSettings
) -> tuple[Float32Array, Float32Array]:
    """Return the step heights and the supported ones."""
    half = disc(settings.step_radius_m, map_.resolution_m)
    cells_min = _cells_min(half, settings.support_share, _STEP_CELLS_MIN)
    steps, supported = (np.empty(map_.state.shape, np.float32) for _ in range(2))
    step_heights(map_.elevation_m, confirmed, half, cells_min, steps)
    supported_steps(steps, half, settings.critical_step_m, settings.step_cells, supported)
    return steps, supported


def score(layer: Float32Array, critical: float) -> Float32Array:
    """Return 1 - value / critical, 0 from the critical value on, NaN for NaN."""
    scores: Float32Array = layer * np.float32(-1.0 / critical)
    scores += np.float32(1.0)
    return np.maximum(scores, np.float32(0.0), out=scores)


def _combined(
    scores: tuple[Float32Array, Float32Array, Float32Array], combination: Combination
) -> Float32Array:
    """Return one value for three; NaN where one of them is."""
    slope, roughness, step = scores
    if combination == "mean":
        return (slope + roughness + step) / np.float32(3.0)
    return np.minimum(np.minimum(slope, roughness), step)
