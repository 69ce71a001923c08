"""From a stream to a trajectory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from acquisition.messages.codec import Recordable
from acquisition.stream.reader import StreamMessage, StreamReader
from drivers.samples import PoseSample, WheelTwistSample
from mapping.ego_motion.calibrated import CalibratedSettings
from mapping.ego_motion.ego_motion import EgoMotion
from mapping.ego_motion.events import EgoEvent
from mapping.ego_motion.paper_motion import PaperMotion
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.errors import MappingError
from mapping.geometry import UncertainPose
from mapping.session import calibrated_motion

Method = Literal["filter", "paper2019"]

_LONGEST_RATE_HZ = 1000.0


class Motion(Protocol):
    """What both methods have in common."""

    @property
    def poses_ready_until_ns(self) -> int | None:
        """The last time for which `pose_at` has an answer."""

    @property
    def events(self) -> Sequence[EgoEvent]:
        """What went wrong so far."""

    def add(self, sample: Recordable) -> None:
        """Take the next sample."""

    def finish(self) -> None:
        """The stream is over."""

    def pose_at(self, t_ns: int) -> UncertainPose | None:
        """Return the pose at a time."""


@dataclass(frozen=True, slots=True)
class OdometryResult:
    """A trajectory, what went wrong on the way, and where the sensors' sigmas come from."""

    poses: list[UncertainPose]
    events: list[EgoEvent]
    inertial: CalibratedSettings


def find_trajectory(
    reader: StreamReader,
    settings: EgoMotionSettings,
    *,
    method: Method = "filter",
    rate_hz: float = 50.0,
    with_wheels: bool = True,
    calibrations: Path | None = None,
    changes: Sequence[str] = (),
    progress: Callable[[StreamMessage], None] = lambda _: None,
) -> OdometryResult:
    """Return the poses of base_link at a fixed rate, in T.

    Args:
        reader: the stream.
        settings: of ego-motion.
        method: the filter, or the equations of the paper.
        rate_hz: poses per second.
        with_wheels: whether wheel twists count.
        calibrations: folder of calibration files; None = those of the recording alone.
        changes: NAME=VALUE of settings, which go before what was calibrated.
        progress: told every message.

    Raises:
        MappingError: the rate is impossible, a calibration or change cannot be used, or the
            stream says nothing about motion.
        StreamError: the stream cannot be read.
    """
    if not 0.0 < rate_hz <= _LONGEST_RATE_HZ:
        raise MappingError(f"{rate_hz} poses per second; expected up to {_LONGEST_RATE_HZ:g}")
    picker: _Picker | None = None
    for message in reader:
        if picker is None:
            inertial = calibrated_motion(settings, reader.metadata, calibrations)
            settings = with_changes(inertial.settings, changes)
            motion: Motion = EgoMotion(settings) if method == "filter" else PaperMotion(settings)
            picker = _Picker(motion, round(1e9 / rate_hz))
        if isinstance(message.sample, WheelTwistSample) and not with_wheels:
            continue
        if isinstance(message.sample, PoseSample) and not settings.use_external_poses:
            continue
        motion.add(message.sample)
        picker.pick()
        progress(message)
    if picker is not None:
        motion.finish()
        picker.pick()
    if picker is None or not picker.poses:
        raise MappingError(
            "the stream says nothing about motion; expected accelerations, yaw rates or wheels"
        )
    return OdometryResult(picker.poses, list(motion.events), inertial)


class _Picker:
    """Takes poses as soon as they are ready, at whole multiples of the period."""

    def __init__(self, motion: Motion, period_ns: int) -> None:
        self._motion = motion
        self._period_ns = period_ns
        self._next_ns: int | None = None
        self.poses: list[UncertainPose] = []

    def pick(self) -> None:
        """Take the poses that are ready by now."""
        ready_ns = self._motion.poses_ready_until_ns
        if ready_ns is None:
            return
        if self._next_ns is None:
            self._next_ns = -(-ready_ns // self._period_ns) * self._period_ns
        while self._next_ns <= ready_ns:
            pose = self._motion.pose_at(self._next_ns)
            if pose is not None:
                self.poses.append(pose)
            self._next_ns += self._period_ns


def with_changes(settings: EgoMotionSettings, changes: Sequence[str]) -> EgoMotionSettings:
    """Return settings with NAME=VALUE applied.

    Raises:
        MappingError: no such setting, or the value is no number.
    """
    values: dict[str, Any] = asdict(settings)
    for change in changes:
        name, separator, text = change.partition("=")
        if not separator or name not in values:
            raise MappingError(f"{change!r} is no NAME=VALUE of a setting of ego-motion")
        try:
            values[name] = type(values[name])(float(text))
        except ValueError as error:
            raise MappingError(f"{name} is {text!r}; expected a number") from error
    return EgoMotionSettings(**values)
