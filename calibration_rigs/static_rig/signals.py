"""The inertial signals of a recording, as arrays."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.reader import StreamReader
from calibration_rigs.errors import RigError
from drivers.samples import AccelerationSample, YawRateSample
from mapping.inertial_calibration import SourceFile

Float64Array = NDArray[np.float64]

# A pause this many times the usual step is a gap; deviations are made of what has none.
_GAP_STEPS = 3.0


@dataclass(frozen=True, slots=True)
class Signal:
    """Samples of one sensor.

    Attributes:
        t_s: (n,) seconds since the first sample of the recording, increasing.
        values: (n, axes), SI.
        temperature_c: (n,) the chip's temperature, NaN where it gave none.
    """

    t_s: Float64Array
    values: Float64Array
    temperature_c: Float64Array

    @property
    def rate_hz(self) -> float:
        """Samples a second, from the median step."""
        return 1.0 / float(np.median(np.diff(self.t_s)))

    def longest_without_gap(self) -> Signal:
        """Return the longest stretch in which no sample is missing."""
        steps = np.diff(self.t_s)
        broken = np.flatnonzero(steps > _GAP_STEPS * np.median(steps)) + 1
        edges = np.concatenate([[0], broken, [len(self.t_s)]])
        longest = int(np.argmax(np.diff(edges)))
        part = slice(int(edges[longest]), int(edges[longest + 1]))
        return Signal(self.t_s[part], self.values[part], self.temperature_c[part])


@dataclass(frozen=True, slots=True)
class Signals:
    """What a recording holds of inertial sensors; None where it holds nothing."""

    source: SourceFile
    gyro: Signal | None
    acceleration: Signal | None


def read_signals(path: Path, progress: Callable[[str], None] = lambda _: None) -> Signals:
    """Read the rates and accelerations of a recording.

    Raises:
        RigError: the recording is damaged or out of order, or holds neither.
        StreamError: it cannot be read.
    """
    rates: list[tuple[int, tuple[float, ...], float]] = []
    forces: list[tuple[int, tuple[float, ...], float]] = []
    with FinishedFile(path) as source:
        reader = StreamReader(source)
        for message in reader:
            _sort_in(message.sample, rates, forces)
            if (len(rates) + len(forces)) % 10_000 == 1:
                progress(f"{len(rates)} rates, {len(forces)} accelerations")
        faults = len(reader.report.damaged) + reader.report.late_messages
        if faults:
            raise RigError(
                f"{path} has {faults} parts that are damaged or out of order; a calibration needs "
                "it whole: run `terravibe recover`, and use what that gives"
            )
    if not rates and not forces:
        raise RigError(f"{path} holds neither /gyro nor /acceleration; record them at rest")
    start_ns = min(items[0][0] for items in (rates, forces) if items)
    return Signals(_source_file(path), _signal(rates, start_ns), _signal(forces, start_ns))


def _sort_in(
    sample: object,
    rates: list[tuple[int, tuple[float, ...], float]],
    forces: list[tuple[int, tuple[float, ...], float]],
) -> None:
    if isinstance(sample, YawRateSample):
        temperature = np.nan if sample.temperature_c is None else sample.temperature_c
        rates.append((sample.t_ns, (sample.rate_rad_s,), temperature))
    elif isinstance(sample, AccelerationSample):
        forces.append((sample.t_ns, tuple(map(float, sample.acceleration_m_s2)), np.nan))


def _signal(items: Iterable[tuple[int, tuple[float, ...], float]], start_ns: int) -> Signal | None:
    rows = sorted(items, key=lambda item: item[0])
    if len(rows) < 3:
        return None
    t_ns = np.array([row[0] for row in rows], np.int64)
    return Signal(
        np.asarray((t_ns - start_ns) * 1e-9, np.float64),
        np.array([row[1] for row in rows], np.float64),
        np.array([row[2] for row in rows], np.float64),
    )


def _source_file(path: Path) -> SourceFile:
    with path.open("rb") as file:
        return SourceFile(name=path.name, sha256=hashlib.file_digest(file, "sha256").hexdigest())
