"""A recording that plays again, as a device: kind "replay"."""

from __future__ import annotations

import struct
import time
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

from mcap.exceptions import McapError
from mcap.reader import make_reader

from acquisition.errors import StreamError
from acquisition.messages import codec
from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.read_report import ReadReport
from acquisition.stream.reader import StreamReader
from drivers.errors import DriverError, EndOfSource
from drivers.faults import NO_FAULTS, Faults
from drivers.samples import Sample
from drivers.source import SourceInfo

# Between the end of one pass and the start of the next, in the stream's time.
_PAUSE_NS = 100_000_000


@dataclass(frozen=True, slots=True)
class _Timed:
    log_time_ns: int
    sample: Sample


@dataclass(frozen=True, slots=True)
class _Start:
    """When playing began, by the clock and by the recording."""

    clock_ns: int
    log_time_ns: int


class Replay:
    """Gives the samples of a recording in order of log time.

    Times are as recorded. With repeats, each pass is moved behind the one before it, in time and
    in sequence numbers, so that both keep rising. What is no sample (static transforms, clocks,
    diagnostics) is left out. Damage is an error: what is replayed is the whole recording.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        name: str = "replay",
        speed: float = 1.0,
        repeats: int = 1,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        """Touch nothing yet.

        Args:
            path: the recording.
            name: the instance's name.
            speed: 1 = as it was recorded, 2 = twice as fast, 0 = as fast as it is read.
            repeats: how often to play it.
            clock_ns: a monotonic clock.
            sleep: waits that many seconds.

        Raises:
            DriverError: speed or repeats make no sense.
        """
        if not speed >= 0.0 or repeats < 1:  # NaN too
            raise DriverError(
                f"{name}: speed {speed} and {repeats} repeats; expected speed >= 0, repeats >= 1"
            )
        self._path = Path(path)
        self._name = name
        self._speed = speed
        self._repeats = repeats
        self._clock_ns = clock_ns
        self._sleep = sleep
        self._samples: Generator[_Timed, None, None] | None = None
        self._next: _Timed | None = None
        self._started: _Start | None = None

    @property
    def name(self) -> str:
        """The instance's name."""
        return self._name

    @property
    def faults(self) -> Faults:
        """None: what a recording lost is told by its own health records."""
        return NO_FAULTS

    def open(self) -> SourceInfo:
        """Look at the recording's index, and make ready to play from the start.

        Raises:
            DriverError: no recording, or one without an index, as after a crash.
        """
        self.close()
        produces = _indexed_types(self._path, self._name)
        self._samples = self._passes()
        return SourceInfo(self._name, "replay", "", produces, "recorded", {"path": str(self._path)})

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """Return the next sample when its time has come; see `drivers.source.Source`.

        Raises:
            DriverError: not open, or the recording is damaged.
            EndOfSource: the last pass is over.
        """
        if self._samples is None:
            raise DriverError(f"{self._name}: not open")
        if self._next is None:
            self._next = self._following(self._samples)
        wait_s = self._wait_s(self._next.log_time_ns)
        if wait_s > timeout_s:
            self._sleep(timeout_s)
            return ()
        if wait_s > 0.0:
            self._sleep(wait_s)
        sample, self._next = self._next.sample, None
        return (sample,)

    def close(self) -> None:
        """Close the recording; harmless when it is closed."""
        if self._samples is not None:
            self._samples.close()
        self._samples = self._next = self._started = None

    def _following(self, samples: Generator[_Timed, None, None]) -> _Timed:
        try:
            return next(samples)
        except StopIteration:
            raise EndOfSource from None
        except StreamError as error:
            raise DriverError(f"{self._name}: {error}") from error

    def _wait_s(self, log_time_ns: int) -> float:
        """Return how long the sample of that log time is still ahead."""
        if self._speed == 0.0:
            return 0.0
        now_ns = self._clock_ns()
        if self._started is None:
            self._started = _Start(now_ns, log_time_ns)
        ahead_ns = (log_time_ns - self._started.log_time_ns) / self._speed
        return max(0.0, (ahead_ns - (now_ns - self._started.clock_ns)) * 1e-9)

    def _passes(self) -> Generator[_Timed, None, None]:
        """Give every pass, each behind the one before it."""
        shift_ns = 0
        numbers: Counter[type[Sample]] = Counter()
        for _ in range(self._repeats):
            before = numbers.copy()
            first_ns = last_ns = None
            with closing(self._one_pass()) as one_pass:
                for log_time_ns, sample in one_pass:
                    first_ns = log_time_ns if first_ns is None else first_ns
                    last_ns = log_time_ns
                    number = before[type(sample)] + sample.sequence
                    numbers[type(sample)] = number + 1
                    moved = replace(sample, t_ns=sample.t_ns + shift_ns, sequence=number)
                    yield _Timed(log_time_ns + shift_ns, moved)
            if first_ns is not None and last_ns is not None:
                shift_ns += last_ns - first_ns + _PAUSE_NS

    def _one_pass(self) -> Generator[tuple[int, Sample], None, None]:
        with FinishedFile(self._path) as file:
            reader = StreamReader(file)
            for message in reader:
                _refuse_damage(reader.report)
                if isinstance(message.sample, Sample):
                    yield message.log_time_ns, message.sample
            _refuse_damage(reader.report)
            _refuse_loss(reader.report)


def _refuse_damage(report: ReadReport) -> None:
    if report.damaged:
        raise StreamError(f"{report.name} is damaged: {report.damaged[0].describe()}")


def _refuse_loss(report: ReadReport) -> None:
    if not report.complete:
        raise StreamError(f"{report.name} has no proper end")
    if report.late_messages:
        raise StreamError(
            f"{report.name} holds {report.late_messages} messages too late to be put into order"
        )


def _indexed_types(path: Path, name: str) -> tuple[type[Sample], ...]:
    """Return the sample types of which the recording's index announces messages."""
    try:
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
    except OSError as error:
        raise DriverError(f"{name}: cannot read {path}: {error.strerror}") from error
    except (McapError, struct.error, ValueError, OverflowError) as error:
        raise DriverError(f"{name}: {path} has no readable index: {error}") from error
    if summary is None or summary.statistics is None:
        raise DriverError(
            f"{name}: {path} has no index; it was not finished, or not as a recording"
        )
    counts = summary.statistics.channel_message_counts
    channels = [channel for number, channel in summary.channels.items() if counts.get(number)]
    rows = [
        codec.find(channel.topic, summary.schemas[channel.schema_id].name)
        for channel in channels
        if channel.schema_id in summary.schemas
    ]
    types = {row.sample_type for row in rows if row is not None}
    return tuple(kind for kind in get_args(Sample) if kind in types)
