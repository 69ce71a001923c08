"""When the samples of a recording happened by their devices' own clocks, worked out afterwards.

A recording holds what was seen: when a message arrived, and what the device's counter showed. The
arrival is late by a delay that scatters by milliseconds; the counter is exact but counts from
nowhere. `DeviceTimes` puts the two together as `acquisition.clocks.device_clock` explains, one
sample after the other, so that it serves a live stream as well as a file.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from acquisition.clocks.clock_follower import ClockTuning
from acquisition.clocks.device_clock import DeviceClock, DeviceClockSettings
from acquisition.errors import StreamError
from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.provenance import DEVICE_CLOCKS, METADATA_NAME, SOURCE_PREFIX
from acquisition.stream.reader import StreamReader
from drivers.samples import DepthFrame, VibrationSample
from drivers.source import TickCounter


@dataclass(frozen=True, slots=True)
class CorrectedStamp:
    """One sample of a device with a clock.

    Attributes:
        topic: where it was recorded.
        sequence: its number.
        t_ns: its stamp, the arrival of its message.
        corrected_ns: when it happened, in the same time.
    """

    topic: str
    sequence: int
    t_ns: int
    corrected_ns: int


class DeviceTimes:
    """Translates the samples of one recording, which must come in order of time."""

    def __init__(self, settings: Mapping[str, DeviceClockSettings]) -> None:
        """Translate samples of these types, by name; `clock_settings_of` knows a recording's."""
        self._clocks = {kind: DeviceClock(settings[kind]) for kind in settings}

    def corrected_ns(self, sample: object) -> int | None:
        """Return when a sample happened, in the time of its stamp; None without a clock for it."""
        if not isinstance(sample, DepthFrame | VibrationSample) or sample.device_ticks is None:
            return None
        clock = self._clocks.get(type(sample).__name__)
        return clock.translate(sample.device_ticks, sample.t_ns) if clock else None


def clock_settings_of(
    metadata: Mapping[str, Mapping[str, str]],
) -> dict[str, DeviceClockSettings]:
    """Return how to translate the counters of a recording, by the name of the sample type.

    Args:
        metadata: the recording's metadata records, by name.

    Raises:
        StreamError: what the recording says about its clocks makes no sense.
    """
    record = metadata.get(METADATA_NAME, {})
    try:
        tunings = json.loads(record.get("settings", "{}")).get(DEVICE_CLOCKS, {})
        found: dict[str, DeviceClockSettings] = {}
        for key, text in record.items():
            if key.startswith(SOURCE_PREFIX):
                identity = json.loads(text)
                tuning = tunings.get(key.removeprefix(SOURCE_PREFIX), {})
                settings = _settings_of(identity, tuning)
                if settings is not None:
                    found |= dict.fromkeys(identity["produces"], settings)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise StreamError(f"the recording's device clocks make no sense: {error!r}") from error
    return found


def _settings_of(
    identity: Mapping[str, Any], tuning: Mapping[str, Any]
) -> DeviceClockSettings | None:
    counter = identity.get("counter")
    return ClockTuning(**tuning).settings(TickCounter(**counter) if counter else None)


def corrected_stamps(paths: Sequence[Path]) -> Iterator[CorrectedStamp]:
    """Give every sample of a device with a clock, of one recording in parts.

    Raises:
        StreamError: a part cannot be read, or what it says about clocks makes no sense.
    """
    times: DeviceTimes | None = None
    for path in paths:
        with FinishedFile(path) as file:
            reader = StreamReader(file)
            for message in reader:
                times = times or DeviceTimes(clock_settings_of(reader.metadata))
                corrected_ns = times.corrected_ns(message.sample)
                if corrected_ns is not None:
                    t_ns = message.sample.t_ns
                    yield CorrectedStamp(message.topic, message.sequence, t_ns, corrected_ns)
