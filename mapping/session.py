"""From a stream to a map: take the recording's own calibration, map, say how it was made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

from acquisition.clocks.clock_sample import ClockSample
from acquisition.messages.frames import MOCAP_BODY_FRAME
from acquisition.stream.read_report import ReadReport
from acquisition.stream.reader import StreamMessage, StreamReader
from mapping.calibration_file import Calibration, DeviceIdentity
from mapping.cells.elevation_map import ElevationMap
from mapping.ego_motion.calibrated import CalibratedSettings, calibrated
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.errors import MappingError
from mapping.geometry import UncertainPose
from mapping.mapper import Mapper, MapperCounts
from mapping.noise import DepthNoiseModel
from mapping.noise_choice import ChosenNoise, choose_noise
from mapping.paper2019.paper_mapper import PaperMapper
from mapping.recorded import depth_device, depth_devices, recorded_device, recorded_settings
from mapping.settings import MapSettings
from mapping.stored_settings import flat, overlaid
from mapping.undistortion import Undistortion
from mapping.world.tile_store import TileStore
from mapping.world.world_grid import WorldGrid
from mapping.world.world_map import about_world, check_continues

Method = Literal["corrected", "paper2019"]


@dataclass(frozen=True, slots=True)
class MapOptions:
    """What the user asked for; None = as the recording says, else the default.

    Attributes:
        settings: the map's settings; their mount sigmas count only when the two below are None
            and the recording says nothing.
        given: names of the settings that the user gave; the others yield to the recording's own
            map section (rover.toml).
        noise: depth noise model, or a calibration, which is refused for another device.
        calibrations: folder of calibration files; that of the recording's depth camera is used
            when no noise is given.
        undistortion: of the depth camera, pixel by pixel; refused for another device.
        mount_sigma_m, mount_sigma_rad: uncertainty of the depth sensor's mount.
        world: folder of a world map that keeps what leaves the scrolling window.
        continue_world: whether that world is there already.
        method: "corrected", or "paper2019" for the printed equations (`mapping.paper2019`).
    """

    settings: MapSettings
    given: frozenset[str] = frozenset()
    noise: DepthNoiseModel | Calibration | None = None
    calibrations: Path | None = None
    undistortion: Undistortion | None = None
    mount_sigma_m: float | None = None
    mount_sigma_rad: float | None = None
    world: Path | None = None
    continue_world: bool = False
    method: Method = "corrected"


@dataclass(frozen=True, slots=True)
class MapResult:
    """A map, what the reader found in the stream, and what became of it.

    Attributes:
        map, report, counts, settings, noise: as their names say.
        poses: those that the depth frames were mapped from.
        inertial: where the sigmas of the motion sensors come from; None without ego-motion.
        body_frame: the frame whose poses they are.
        noise_warning: why no calibration of the device is used though one was wanted, or "".
        depth_devices: cameras that the recording names; several in a merged one.
    """

    map: ElevationMap
    report: ReadReport
    counts: MapperCounts
    settings: MapSettings
    noise: DepthNoiseModel
    poses: tuple[UncertainPose, ...] = ()
    inertial: CalibratedSettings | None = None
    body_frame: str = MOCAP_BODY_FRAME
    noise_warning: str = ""
    depth_devices: tuple[DeviceIdentity, ...] = ()


def map_stream(
    reader: StreamReader,
    options: MapOptions,
    progress: Callable[[StreamMessage], None] = lambda _: None,
    prepare: Callable[[], None] = lambda: None,
) -> MapResult:
    """Map a stream until its end.

    Args:
        reader: the stream.
        options: what the user asked for.
        progress: called with each message that was mapped.
        prepare: called once before the first, when stream and options are found to be usable.

    Raises:
        MappingError: nothing can be mapped, or the recording's own calibration is unusable.
        StreamError: the stream cannot be read.
    """
    mapper: Mapper | None = None
    poses: list[UncertainPose] = []
    with ExitStack() as resources:
        for message in reader:
            if mapper is None:
                mapper = _mapper_for(options, reader.metadata, resources, poses.append)
                prepare()
            if not isinstance(message.sample, ClockSample):
                mapper.add(message.sample)
            progress(message)
        mapper = mapper or _mapper_for(options, reader.metadata, resources, poses.append)
        mapper.finish()
        _check_window(mapper, options)
        report = reader.report
        noise = _noise_for(options, reader.metadata)
        map_ = mapper.elevation_map(_attributes(mapper, report) | noise.attributes())
    return MapResult(
        map=map_,
        report=report,
        counts=mapper.counts,
        settings=mapper.settings,
        noise=mapper.noise,
        poses=tuple(poses),
        inertial=_inertial_for(options, mapper.settings, reader.metadata),
        body_frame=mapper.body_frame,
        noise_warning=noise.warning,
        depth_devices=depth_devices(reader.metadata),
    )


def _check_window(mapper: Mapper, options: MapOptions) -> None:
    """Refuse a window that the rover has looked over, unless there is a world behind it.

    Raises:
        MappingError: there were readings, and none of them fell into the window.
    """
    counts = mapper.counts
    if counts.readings and counts.readings == counts.readings_outside and not options.world:
        raise MappingError(
            f"all {counts.readings} depth readings fell outside the window of "
            f"{mapper.settings.window_m:g} m around the rover; use a larger one, in metres"
        )


def _mapper_for(
    options: MapOptions,
    metadata: Mapping[str, Mapping[str, str]],
    resources: ExitStack,
    on_pose: Callable[[UncertainPose], None],
) -> Mapper:
    """Return a mapper with the user's wishes over the recording's over the defaults."""
    recorded = recorded_settings(metadata)
    noise = _noise_for(options, metadata)
    settings = replace(
        _with_recorded_map(options, recorded.get("map")),
        mount_sigma_m=_first(
            options.mount_sigma_m, recorded.get("mount_sigma_m"), options.settings.mount_sigma_m
        ),
        mount_sigma_rad=_first(
            options.mount_sigma_rad,
            recorded.get("mount_sigma_rad"),
            options.settings.mount_sigma_rad,
        ),
    )
    inertial = _inertial_for(options, settings, metadata)
    if inertial is not None:
        settings = replace(settings, ego_motion=inertial.settings)
    if options.undistortion is not None:
        options.undistortion.check_device(depth_device(metadata))
    if options.method == "paper2019":
        return PaperMapper(settings, noise.model, on_pose=on_pose)
    grid = _world_grid(options, settings, noise.model, resources)
    return Mapper(
        settings,
        noise.model,
        grid,
        fallback=noise.fallback,
        undistortion=options.undistortion,
        on_pose=on_pose,
    )


def _inertial_for(
    options: MapOptions, settings: MapSettings, metadata: Mapping[str, Mapping[str, str]]
) -> CalibratedSettings | None:
    """Return what is known of the motion sensors, where they are used; twice is as once."""
    if not settings.pose_source.startswith("ego-motion"):
        return None
    return calibrated_motion(settings.ego_motion, metadata, options.calibrations)


def _world_grid(
    options: MapOptions, settings: MapSettings, noise: DepthNoiseModel, resources: ExitStack
) -> WorldGrid | None:
    """Return a window over the world that the user gave, which `resources` will close."""
    if options.world is None:
        return None
    if settings.grid != "scrolling":
        raise MappingError(
            f"grid is {settings.grid!r}; a world is mapped through a scrolling window"
        )
    if options.continue_world:
        store = resources.enter_context(TileStore.reopen(options.world))
        check_continues(store, settings)
    else:
        about = about_world(settings, noise)
        store = resources.enter_context(TileStore.create(options.world, about))
    return WorldGrid(settings, store)


def calibrated_motion(
    settings: EgoMotionSettings,
    metadata: Mapping[str, Mapping[str, str]],
    calibrations: Path | None,
) -> CalibratedSettings:
    """Return the settings of ego-motion for a recording's own inertial sensors.

    Raises:
        MappingError: see `calibrated`.
    """
    devices = {
        "gyro": recorded_device(metadata, "YawRateSample"),
        "accelerometer": recorded_device(metadata, "AccelerationSample", "VibrationSample"),
    }
    files = recorded_settings(metadata).get("calibration_files")
    return calibrated(settings, devices, files if isinstance(files, dict) else {}, calibrations)


def _noise_for(options: MapOptions, metadata: Mapping[str, Mapping[str, str]]) -> ChosenNoise:
    """Return the noise model of the recording's depth camera; twice is as once."""
    recorded = recorded_settings(metadata)
    return choose_noise(options.noise, options.calibrations, recorded, depth_device(metadata))


def _with_recorded_map(options: MapOptions, section: object) -> MapSettings:
    """Return the settings with what the recording says, where the user says nothing.

    Raises:
        MappingError: the recording's map section is none, or the user gave what has no effect.
    """
    settings = options.settings
    if section is not None:
        where = "the recording's map section"
        settings = overlaid(settings, section, options.given, where)
    if "window_m" in options.given and settings.grid == "growing":
        raise MappingError("window_m is given, but a growing map has none; use a scrolling grid")
    if "tilt_source" in options.given and not settings.pose_source.startswith("ego-motion"):
        raise MappingError(
            f"tilt_source is given, but poses from {settings.pose_source} have their own tilt; "
            "leave it out"
        )
    return settings


def _first(*candidates: object) -> float:
    """Return the first candidate that is given.

    Raises:
        MappingError: it is not a number.
    """
    value = next(candidate for candidate in candidates if candidate is not None)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise MappingError(f"the recording's mount sigma is {value!r}; expected a number")
    return float(value)


def _attributes(mapper: Mapper, report: ReadReport) -> dict[str, str | int | float]:
    """Return how the map was made, for the map file."""
    attributes = dict(flat("setting", asdict(mapper.settings)))
    attributes |= {f"noise_{name}": value for name, value in asdict(mapper.noise).items()}
    attributes |= {
        f"pose_error_{name}": int(value) if isinstance(value, bool) else value
        for name, value in asdict(mapper.pose_errors).items()
    }
    attributes |= {f"input_{name}": value for name, value in asdict(mapper.counts).items()}
    if mapper.undistortion is not None:
        attributes["noise_undistortion"] = mapper.undistortion.where
    attributes["input_complete"] = int(report.complete)
    attributes["input_truncated_bytes"] = report.truncated_bytes
    attributes["input_damaged_parts"] = len(report.damaged)
    attributes["input_late_messages"] = report.late_messages
    return attributes
