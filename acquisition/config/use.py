"""From rover.toml to what the recorder is made of."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from acquisition.clocks.clock_follower import ClockTuning
from acquisition.config.device_settings import problems_of, with_paths_from
from acquisition.config.model import (
    REPLAY_KIND,
    DeviceClockSection,
    DeviceEntry,
    Mount,
    RoverConfig,
)
from acquisition.config.rover_file import LoadedConfig, parse, problems_in, read
from acquisition.config.suggestion import suggestion
from acquisition.errors import ConfigError
from acquisition.messages import codec
from acquisition.messages.frames import DEPTH_OPTICAL_FRAME, MOUNTED_FRAMES, StaticTransform
from acquisition.messages.ros_fields import unit_quaternion
from acquisition.recording.disk_output import DiskOutput
from acquisition.recording.folder_store import MB, DiskSettings
from acquisition.recording.output import RecordingOutput
from acquisition.recording.plan import RecordingPlan
from acquisition.recording.ring_output import RingOutput, RingSettings
from acquisition.recording.source_worker import WorkerSettings
from acquisition.replay import Replay
from acquisition.stream.open_part import PartLimits
from acquisition.stream.provenance import DEVICE_CLOCKS
from drivers.errors import TerravibeError, reason_of
from drivers.samples import Float64Array, Sample, frozen_array
from drivers.source import Source, source_class
from drivers.vibration.profile import load_profile

_NS_PER_S = 1_000_000_000


def sources_of(loaded: LoadedConfig) -> list[Source]:
    """Construct every device; touches none.

    Raises:
        ConfigError: there are no devices, or the settings of one do not fit its driver.
        DriverError: the driver refuses their values.
    """
    _require_devices(loaded)
    return [_source(loaded, i, entry) for i, entry in enumerate(loaded.config.devices)]


def _require_devices(loaded: LoadedConfig) -> None:
    if not loaded.config.devices:
        raise ConfigError(f"{loaded.path}: no devices; add a [[devices]] block")


def _source(loaded: LoadedConfig, number: int, entry: DeviceEntry) -> Source:
    if problems := _setting_problems(loaded, number, entry):
        raise ConfigError(problems[0])
    factory = _factory(entry)
    return factory(**with_paths_from(factory, entry.settings(), loaded.path.parent))


def _factory(entry: DeviceEntry) -> Callable[..., Source]:
    return Replay if entry.kind == REPLAY_KIND else source_class(entry.kind)


def _setting_problems(loaded: LoadedConfig, number: int, entry: DeviceEntry) -> list[str]:
    problems = problems_of(_factory(entry), entry.settings())
    return [f"{loaded.where('devices', number)}: kind {entry.kind!r}: {text}" for text in problems]


def static_transforms_of(config: RoverConfig) -> list[StaticTransform]:
    """Return the mounts as transforms."""
    return [
        StaticTransform(mount.parent, frame, frozen_array(mount.position_m, (3,)), _quat(mount))
        for frame, mount in config.mounts.items()
    ]


def _quat(mount: Mount) -> Float64Array:
    """Return the mount's rotation as w, x, y, z; roll, pitch, yaw as in REP 103, R = Rz Ry Rx."""
    if mount.quaternion_wxyz is not None:
        return unit_quaternion(mount.quaternion_wxyz)
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_euler("xyz", mount.roll_pitch_yaw_deg, degrees=True).as_quat()
    return frozen_array((w, x, y, z), (4,))


def rates_of(config: RoverConfig) -> dict[type[Sample], float]:
    """Return the expected rates by sample type."""
    rows = {row.topic: row.sample_type for row in codec.MESSAGE_TYPES}
    return {
        kind: rate_hz
        for topic, rate_hz in config.rates_hz.items()
        if issubclass(kind := rows[topic], Sample)
    }


def resolved(loaded: LoadedConfig) -> dict[str, object]:
    """Return every setting, defaults included, as the JSON values that a recording keeps.

    Beside the sections of the file: "depth_noise", the content of that calibration file;
    "calibration_files", the contents of the others by name; "mount_sigma_m" and
    "mount_sigma_rad" of the depth camera, by the names that mapping asks for.

    Raises:
        ConfigError: a calibration file cannot be read.
    """
    config = loaded.config
    settings: dict[str, object] = config.model_dump(mode="json")
    files = config.calibration
    if files.depth_noise is not None:
        settings["depth_noise"] = _json_of(loaded, files.depth_noise)
    settings["calibration_files"] = {path.name: _json_of(loaded, path) for path in files.others}
    mount = config.mounts.get(DEPTH_OPTICAL_FRAME)
    if mount is not None:
        settings["mount_sigma_m"] = mount.sigma_m
        settings["mount_sigma_rad"] = math.radians(mount.sigma_deg)
    return settings


def _json_of(loaded: LoadedConfig, path: Path) -> object:
    try:
        return json.loads(loaded.resolve(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        where = loaded.where("calibration")
        raise ConfigError(
            f"{where}: cannot use calibration file {path}: {reason_of(error)}"
        ) from error


def plan_of(loaded: LoadedConfig, sources: Sequence[Source]) -> RecordingPlan:
    """Return how to record what `sources_of` returned.

    Raises:
        ConfigError: a calibration file cannot be read.
    """
    section = loaded.config.recording
    pairs = zip(sources, loaded.config.devices, strict=True)
    clocks = {source.name: _tuning(entry.clock) for source, entry in pairs}
    told = {name: asdict(tuning) for name, tuning in clocks.items()}
    return RecordingPlan(
        static_transforms=static_transforms_of(loaded.config),
        settings=resolved(loaded) | {DEVICE_CLOCKS: told},
        rates_hz=rates_of(loaded.config),
        clocks=clocks,
        require_all=section.require_all,
        depth_format=section.depth_format,
        flush_interval_s=section.flush_ms * 1e-3,
        preflight_timeout_s=section.preflight_s,
        worker=WorkerSettings(
            queue_limit_bytes=section.queue_mb * MB,
            reconnect_s=section.reconnect_s,
            realtime_priority=section.realtime_priority,
        ),
    )


def _tuning(section: DeviceClockSection) -> ClockTuning:
    return ClockTuning(
        section.tick_rate_hz,
        section.wrap_ticks,
        window_s=section.window_s,
        max_drift_ppm=section.max_drift_ppm,
        min_delay_ns=round(section.min_delay_ms * 1e6),
    )


def recording_path(loaded: LoadedConfig, epoch_ns: int) -> Path:
    """Return FOLDER/NAME_YYYYMMDDTHHMMSSZ.mcap for a recording that starts at that time.

    A vehicle without a clock may start twice at the same time; then "-2" and so on is added.
    """
    section = loaded.config.recording
    stamp = datetime.fromtimestamp(epoch_ns / _NS_PER_S, UTC).strftime("%Y%m%dT%H%M%SZ")
    folder = loaded.resolve(section.folder)
    stem, number = f"{section.name}_{stamp}", 1
    while any(folder.glob(f"{stem}{_suffix(number)}[._]*")):
        number += 1
    return folder / f"{stem}{_suffix(number)}.mcap"


def _suffix(number: int) -> str:
    return "" if number == 1 else f"-{number}"


def output_of(loaded: LoadedConfig, path: Path) -> RecordingOutput:
    """Return where the recording goes: the ring when `ring_s` is given, else the disk."""
    section = loaded.config.recording
    reserve_bytes = section.disk_reserve_mb * MB
    if section.ring_s > 0.0:
        duration_ns = int(section.ring_s * _NS_PER_S)
        settings = RingSettings(duration_ns, section.ring_memory_mb * MB, reserve_bytes)
        return RingOutput(path, settings)
    limits = PartLimits(section.split_mb * MB, int(section.split_s * _NS_PER_S))
    folders = tuple(map(loaded.resolve, section.fallback_folders))
    return DiskOutput(path, DiskSettings(folders, limits, reserve_bytes, section.sync_s))


def check(path: Path) -> list[str]:
    """Return everything that is wrong with a configuration, one line each; touches no device.

    Raises:
        ConfigError: the file cannot be read.
    """
    text = read(path)
    if problems := problems_in(text, path):
        return problems
    loaded = parse(text, path)
    found = [*_device_problems(loaded)]
    for step in (partial(_require_devices, loaded), partial(resolved, loaded)):
        try:
            step()
        except TerravibeError as error:
            found.append(str(error))
    return [*found, *_mounts_of_nothing(loaded), *_missing_folders(loaded)]


def _device_problems(loaded: LoadedConfig) -> Iterator[str]:
    names: set[str] = set()
    for number, entry in enumerate(loaded.config.devices):
        problems = _setting_problems(loaded, number, entry)
        yield from problems
        if problems:
            continue
        where = loaded.where("devices", number)
        try:
            name = _source(loaded, number, entry).name
            _require_profile(loaded, entry)
        except TerravibeError as error:
            yield f"{where}: {error}"
            continue
        if name in names:
            yield f"{where}: another device is called {name!r} too; give this one a name of its own"
        names.add(name)


def _require_profile(loaded: LoadedConfig, entry: DeviceEntry) -> None:
    """Refuse a vibration sensor's profile that opening the sensor would refuse."""
    profile = entry.settings().get("profile")
    if entry.kind == "vibration" and isinstance(profile, str):
        beside = loaded.resolve(Path(profile))
        load_profile(beside if beside.exists() else profile)


def _missing_folders(loaded: LoadedConfig) -> Iterator[str]:
    section = loaded.config.recording
    keys = ["folder", *["fallback_folders"] * len(section.fallback_folders)]
    for key, folder in zip(keys, (section.folder, *section.fallback_folders), strict=True):
        if not loaded.resolve(folder).is_dir():
            where = loaded.where("recording", key)
            yield f"{where}: there is no folder {loaded.resolve(folder)}; create it"


def _mounts_of_nothing(loaded: LoadedConfig) -> Iterator[str]:
    """Give a line for each mount that neither a sensor nor another mount refers to."""
    mounts = loaded.config.mounts
    known = {*MOUNTED_FRAMES, *(mount.parent for mount in mounts.values())}
    for frame in (frame for frame in mounts if frame not in known):
        hint = suggestion(frame, MOUNTED_FRAMES) or f"expected one of {', '.join(MOUNTED_FRAMES)}"
        yield f"{loaded.where('mounts', frame)}: no sensor has this frame; {hint}"
