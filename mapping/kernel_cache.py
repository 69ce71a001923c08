"""The mapping kernels: whether they are compiled, and compiling them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from acquisition.kernel_cache import are_cached, note_use
from drivers.samples import AccelerationSample, CameraIntrinsics
from mapping import measurement_kernels
from mapping.alignment import plane_kernels, point_kernels, residual_kernels
from mapping.alignment.scan_to_map import ScanAligner
from mapping.alignment.settings import AlignmentSettings
from mapping.cells import part_kernels, relief_kernels, update_kernels
from mapping.cells.elevation_map import read_out
from mapping.cells.grid import GrowingGrid
from mapping.cells.update_constants import fusion_constants
from mapping.change import hidden, overhang, own_body, visibility
from mapping.change.visibility import clear_seen_through, sight_of
from mapping.ego_motion import filter_kernels
from mapping.ego_motion.ego_motion import EgoMotion
from mapping.geometry import RigidTransform, UncertainPose
from mapping.ground import (
    fill_kernels,
    fusion_kernels,
    layer_kernels,
    place_kernels,
    step_kernels,
    surface_kernels,
)
from mapping.ground.fill import fill_gaps
from mapping.ground.fusion import fuse_map
from mapping.ground.layers import derive
from mapping.measurement import FrameReducer, View
from mapping.motion import read_out_kernels
from mapping.motion.ledger import at_rest
from mapping.noise import NGUYEN_2012
from mapping.settings import MapSettings

_ENTRY_POINTS = (
    measurement_kernels.ranges_from_millimetres,
    measurement_kernels.accumulate,
    update_kernels.fuse,
    point_kernels.group_points,
    plane_kernels.fit_planes,
    residual_kernels.normal_equations,
    own_body.drop_readings,
    overhang.drop_readings,
    visibility.look_through,
    hidden.mark_jumps,
    read_out_kernels.add_errors,
    relief_kernels.surrounding_relief,
    part_kernels.slopes,
    part_kernels.noise_of_heights,
    part_kernels.combine,
    layer_kernels.plane_layers,
    step_kernels.step_heights,
    step_kernels.supported_steps,
    fill_kernels.measure_errors,
    fill_kernels.bridge,
    place_kernels.choose_blocks,
    place_kernels.widest_places,
    surface_kernels.load_surface,
    surface_kernels.mean_height,
    surface_kernels.over_blocks,
    fusion_kernels.integrate,
    filter_kernels.run,
)


def kernels_are_cached() -> bool:
    """Tell whether the kernels were all compiled earlier by this installation."""
    return are_cached(_ENTRY_POINTS)


def filter_is_cached() -> bool:
    """Tell whether that of ego-motion was."""
    return are_cached((filter_kernels.run,))


def compile_filter() -> None:
    """Compile the kernel of ego-motion, or load it from the cache, by resting for a moment."""
    ego = EgoMotion()
    for tick in range(3):
        ego.add(AccelerationSample(tick * 10**7, np.array([0.0, 0.0, 9.8]), tick))
    ego.finish()
    note_use((filter_kernels.run,))


def compile_kernels() -> None:
    """Compile the kernels, or load them from the cache, by mapping one tiny frame."""
    camera = CameraIntrinsics(16, 12, 16.0, 16.0, 7.5, 5.5)
    # So that cells of this frame are confirmed: of others nothing is fused.
    settings = MapSettings(confirmed_frames=1, confirmed_pixels=1)
    reducer = FrameReducer(camera, NGUYEN_2012, settings)
    looking_down = RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))
    view = View(UncertainPose(0, looking_down, np.zeros((6, 6))), looking_down)
    reducer.load(np.full((12, 16), 1000, np.uint16))
    own_body.drop_own_body(reducer.readings, [(5.0, 5.0, 5.0, 6.0, 6.0, 6.0)], looking_down)
    grid = GrowingGrid(settings)
    window = grid.prepare(reducer.footprint(view), 0.0, 0.0)
    sums, _ = reducer.reduce(view, window)
    constants = reducer.frame_constants(view, window, grid.position(window))
    overhang.drop_overhangs(reducer.readings, view, constants, grid.layers, settings)
    sight = sight_of(camera, NGUYEN_2012, view, 1)
    clear_seen_through(np.full((12, 16), 1000, np.uint16), sums, constants, sight, grid.layers)
    hidden.mark_hidden(reducer.readings, view, constants, sight, grid.layers.hidden)
    update_kernels.fuse(sums, constants, fusion_constants(settings), grid.layers, at_rest())
    ScanAligner(AlignmentSettings(), settings.resolution_m).align(reducer, view, grid)
    map_ = read_out(grid, settings, {})
    derive(map_)
    fuse_map(map_)
    # Places so uncertain that their ellipses are sampled at blocks.
    wide = {name: getattr(map_, name) * 1e3 for name in ("horizontal_xx_m2", "horizontal_yy_m2")}
    fuse_map(replace(map_, **wide))
    fill_gaps(map_, settings.resolution_m)
    compile_filter()
    note_use(_ENTRY_POINTS)
