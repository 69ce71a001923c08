"""Ready-made worlds to drive in: ground, way, devices and sunlight under one name."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from simulation.devices.camera_mount import CameraMount, on_rover
from simulation.devices.depth_camera import ZENITH, DepthCamera
from simulation.devices.kinect import KinectModel, kinect_320
from simulation.errors import SimulationError
from simulation.terrain.ground_layout import Extent
from simulation.terrain.height_grid import HeightGrid
from simulation.terrain.lunar_terrain import lunar_terrain
from simulation.terrain.man_made import indoor_hall, outdoor_field
from simulation.vehicle.backing_off import BackingOff
from simulation.vehicle.drive_commands import DriveCommands, Waypoints
from simulation.vehicle.routes import Point, around_rocks, circle, there_and_back
from simulation.vehicle.vehicle_run import LONGEST_S, DriveOptions

Poses = Literal["true", "mocap"]

SHORTEST_S = 4.0
LARGEST_SEED = 2**32 - 1
_SPEED_M_S = 0.3
_REACHED_M = 0.25
_CIRCLE_M = 3.0
_CIRCLE_STEP_M = 0.4
# Around that circle, and what the camera sees from it.
_MOON_EXTENT: Extent = (-9.0, 9.0, -6.0, 12.0)
_HALL_LENGTH_M = 7.0
_FIELD_LENGTH_M = 11.0
# A low sun: at right angles to it as bright as the pattern at about 4 m.
_SUNLIGHT = 0.06
_SUN = (-0.5, 0.6, 0.6)


@dataclass(frozen=True, slots=True)
class Scenario:
    """A world, and a drive through it.

    Attributes:
        name, seed, seconds: as they were asked for; the rest at the beginning counts.
        commands: the drive.
        options: vehicle and devices.
        camera: the depth camera, over the ground.
        mount: where it sits on the rover.
        poses: what reports the rover's poses: "true" ones, or motion capture with its noise.
    """

    name: str
    seed: int
    seconds: float
    commands: DriveCommands
    options: DriveOptions
    camera: DepthCamera
    mount: CameraMount
    poses: Poses

    @property
    def ground(self) -> HeightGrid:
        """Return the ground that vehicle, camera and truth share."""
        return self.camera.ground


@dataclass(frozen=True, slots=True)
class _World:
    """What differs from scenario to scenario."""

    ground: HeightGrid
    points_m: list[Point]
    options: DriveOptions
    model: KinectModel
    sun: tuple[float, float, float]
    poses: Poses


def make_scenario(name: str, seed: int, seconds: float, poses: Poses | None = None) -> Scenario:
    """Return a scenario; same arguments, same world.

    Args:
        name: one of `SCENARIOS`.
        seed: of the ground and of all devices; 0 to 2^32 - 1.
        seconds: length of the run, `SHORTEST_S` to `LONGEST_S`.
        poses: None = as the scenario has it.

    Raises:
        SimulationError: an unknown name, or a seed or length that is impossible.
    """
    if name not in SCENARIOS:
        raise SimulationError(f"no scenario {name!r}; expected one of {', '.join(SCENARIOS)}")
    if not 0 <= seed <= LARGEST_SEED:
        raise SimulationError(f"seed {seed}; expected 0 to {LARGEST_SEED}")
    if not SHORTEST_S <= seconds <= LONGEST_S:
        raise SimulationError(f"a run of {seconds} s; expected {SHORTEST_S:g} to {LONGEST_S:g} s")
    if poses is not None and poses not in get_args(Poses):
        raise SimulationError(f"poses {poses!r}; expected one of {', '.join(get_args(Poses))}")
    world = SCENARIOS[name](seed, seconds)
    camera = DepthCamera(world.ground, kinect_320(), world.model, seed, world.sun)
    commands = BackingOff(Waypoints(world.points_m, _SPEED_M_S, _REACHED_M))
    return Scenario(
        name, seed, seconds, commands, world.options, camera, on_rover(), poses or world.poses
    )


def _moon(preset: str) -> Callable[[int, float], _World]:
    """Return a maker of lunar ground with a circle of 3 m around its rocks; Earth's gravity."""

    def make(seed: int, seconds: float) -> _World:
        """Return a world with as many laps as the time allows."""
        terrain = lunar_terrain(preset, seed, extent=_MOON_EXTENT)
        lap = around_rocks(*circle(_CIRCLE_M, _CIRCLE_STEP_M), terrain.rocks)
        laps = math.ceil(seconds * _SPEED_M_S / (2.0 * math.pi * _CIRCLE_M))
        return _World(terrain.grid, lap * laps, DriveOptions(), KinectModel(), ZENITH, "true")

    return make


def _indoor(seed: int, seconds: float) -> _World:
    """Return the hall, driven there and back over the carpet on hard ground."""
    points = there_and_back(_HALL_LENGTH_M, seconds * _SPEED_M_S)
    options = DriveOptions(contact="native")
    return _World(indoor_hall(seed), points, options, KinectModel(), ZENITH, "mocap")


def _outdoor(seed: int, seconds: float) -> _World:
    """Return the field in the evening sun, driven there and back."""
    points = there_and_back(_FIELD_LENGTH_M, seconds * _SPEED_M_S)
    model = KinectModel(sunlight=_SUNLIGHT)
    return _World(outdoor_field(seed), points, DriveOptions(), model, _SUN, "true")


SCENARIOS: Mapping[str, Callable[[int, float], _World]] = {
    "simulation": _moon("nominal"),
    "smooth": _moon("smooth"),
    "rough": _moon("rough"),
    "indoor": _indoor,
    "outdoor": _outdoor,
}
