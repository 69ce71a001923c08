"""Full load on the recorder: drops, CPU, lateness of stamps, memory, and the bare writer beside it.

    python -m benchmarks.recorder --seconds 600 --json recorder.json

Prints for each recorded second: CPU of the process, of its fake devices alone, and of the bare
mcap writer that is given the very messages of this run. The bar is (process - fakes) / bare.

The bare writer is a loop over `mcap.writer.Writer.add_message` and nothing else: the bytes of this
run's first 20 s, already serialised and in memory, closed into chunks as often (50 ms), with the
same compression (zstd at the library's level) and checksums, into an unbuffered file. It reads no
device, stamps, numbers, counts, checks and synchronises nothing. Three floors are measured:

    bare        the loop as fast as it can go
    paced       the same loop in real time: as a recorder must, it sleeps until a flush is due,
                and so finds its caches cold
    serialise   what rosbags takes to turn the same messages into bytes, which an application
                that has no messages yet must add to either
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import tempfile
import threading
import time
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray

from acquisition.messages import codec
from acquisition.recording.disk_output import DiskOutput
from acquisition.recording.folder_store import DiskSettings
from acquisition.recording.plan import RecordingPlan, RecordingResult
from acquisition.recording.recorder import Recorder
from acquisition.recording.source_worker import WorkerSettings
from acquisition.recovery.container import Container, RecordedMessage
from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.open_part import PartLimits
from benchmarks.load import sources
from tests.fakes.paced_source import PacedSource

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]
BAR = 1.5
_FLUSH_NS = 50_000_000
_BARE_SECONDS = 20.0
_PAGE_MB = resource.getpagesize() / 1e6


def main() -> None:
    """Run, print, and write the figures to a file where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=_Raw)
    parser.add_argument("--seconds", type=float, default=600.0, help="default 600")
    parser.add_argument("--priority", type=int, default=0, help="SCHED_FIFO priority of the fakes")
    parser.add_argument("--split", type=float, default=300.0, help="part length, s; default 300")
    parser.add_argument("--folder", type=Path, help="where to record; default: a temporary folder")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        figures = measure(Path(folder), arguments)
    for name, value in figures.items():
        print(f"{name:34} {value}")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2))


class _Raw(argparse.RawDescriptionHelpFormatter):
    pass


def measure(folder: Path, arguments: argparse.Namespace) -> dict[str, object]:
    """Return every figure, by name."""
    seconds: float = arguments.seconds
    fakes_seconds = min(10.0, seconds / 4)
    fakes_before_s = _cpu_of_fakes(fakes_seconds)
    devices = sources()
    memory = _Memory()
    result, process_s = _record(folder / "load.mcap", devices, arguments, memory)
    fakes_s = (fakes_before_s + _cpu_of_fakes(fakes_seconds)) / 2.0
    recorded, recorded_s = _recorded(result.files[0])
    bare_s = _bare(recorded, folder / "bare.mcap", _Counted) / recorded_s
    paced_s = _bare(recorded, folder / "paced.mcap", _Paced) / recorded_s
    serialise_s = _serialise(recorded) / recorded_s
    cost_s = process_s - fakes_s
    return {
        "seconds": seconds,
        "outcome": result.outcome,
        "parts": len(result.files),
        "samples": sum(device.given for device in devices),
        "dropped": sum(source.queue.dropped for source in result.health.sources),
        "unwritten": result.unwritten,
        "missed": _missed(result),
        "highest_queue_mb": max(s.queue.highest_bytes for s in result.health.sources) / 1e6,
        "file_mb_per_s": round(result.health.bytes_written / 1e6 / seconds, 2),
        "process_cpu_s_per_s": round(process_s, 4),
        "fakes_cpu_s_per_s": round(fakes_s, 4),
        "recorder_cpu_s_per_s": round(cost_s, 4),
        "bare_mcap_cpu_s_per_s": round(bare_s, 4),
        "paced_mcap_cpu_s_per_s": round(paced_s, 4),
        "bare_seconds": round(recorded_s, 1),
        "serialise_cpu_s_per_s": round(serialise_s, 4),
        "ratio_to_bare": round(cost_s / bare_s, 3),
        "ratio_to_paced": round(cost_s / paced_s, 3),
        "ratio_to_bare_with_serialising": round(cost_s / (bare_s + serialise_s), 3),
        "bar": BAR,
        **{
            f"late_ms_p{p}_{device.name}": round(device.lateness_ms(p), 2)
            for device in devices
            for p in (50, 99)
        },
        **memory.figures(),
    }


def _missed(result: RecordingResult) -> int:
    return sum(s.statistics.missed for source in result.health.sources for s in source.streams)


def _record(
    path: Path, devices: list[PacedSource], arguments: argparse.Namespace, memory: _Memory
) -> tuple[RecordingResult, float]:
    """Record; return how it went, and CPU seconds for each second."""
    seconds: float = arguments.seconds
    plan = RecordingPlan(worker=WorkerSettings(realtime_priority=arguments.priority))
    limits = PartLimits(duration_ns=int(arguments.split * 1e9))
    recorder = Recorder(devices, DiskOutput(path, DiskSettings(limits=limits)), plan)
    recorder.preflight()
    stop = threading.Event()
    timer = threading.Timer(seconds, stop.set)
    timer.start()
    began_s = time.process_time()
    result = recorder.run(stop, lambda _: memory.sample())
    return result, (time.process_time() - began_s) / seconds


def _cpu_of_fakes(seconds: float) -> float:
    """Return what the fake devices cost when nobody records them, CPU seconds for each second."""
    stop = threading.Event()

    def live(device: PacedSource) -> None:
        device.open()
        while not stop.is_set():
            device.read(0.1)

    threads = [threading.Thread(target=live, args=(device,)) for device in sources()]
    began_s = time.process_time()
    for thread in threads:
        thread.start()
    stop.wait(seconds)
    stop.set()
    for thread in threads:
        thread.join()
    return (time.process_time() - began_s) / seconds


def _recorded(path: Path) -> tuple[list[RecordedMessage], float]:
    """Return the first messages of the recording, and how many seconds they cover."""
    found: list[RecordedMessage] = []
    with FinishedFile(path) as file:
        for message in Container(file):
            found.append(message)
            if message.log_time_ns - found[0].log_time_ns > _BARE_SECONDS * 1e9:
                break
    return found, (found[-1].log_time_ns - found[0].log_time_ns) * 1e-9


def _bare(recorded: list[RecordedMessage], path: Path, wrap: type[_Counted]) -> float:
    """Write the same messages with mcap alone, flushed as often; return CPU seconds."""
    with path.open("wb", buffering=0) as file:
        began_s = time.process_time()
        _write_bare(wrap(file), recorded)
        return time.process_time() - began_s


def _write_bare(file: _Counted, recorded: list[RecordedMessage]) -> None:
    writer = Writer(file)  # type: ignore[arg-type] # it uses write, tell and flush only
    writer.start("ros2")
    channels: dict[str, int] = {}
    for row in codec.MESSAGE_TYPES:
        text = codec.schema_text(row.ros_type).encode()
        schema = writer.register_schema(row.ros_type, "ros2msg", text)
        channels[row.topic] = writer.register_channel(row.topic, "cdr", schema)
    flushed_ns = recorded[0].log_time_ns
    for message in recorded:
        time_ns = message.log_time_ns
        channel = channels[message.topic]
        writer.add_message(channel, time_ns, message.data, time_ns, message.sequence)
        if time_ns - flushed_ns >= _FLUSH_NS:
            writer.flush()
            flushed_ns = time_ns
    writer.finish()


class _Counted:
    """A raw file with a position that costs no system call, which is to mcap's advantage."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._length = 0

    def write(self, data: bytes) -> int:
        self._length += len(data)
        return self._file.write(data)

    def tell(self) -> int:
        return self._length

    def flush(self) -> None:
        self._file.flush()


class _Paced(_Counted):
    """Sleeps at each flush until the next one is due."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file)
        self._due_s = time.monotonic()

    def flush(self) -> None:
        super().flush()
        self._due_s += _FLUSH_NS * 1e-9
        time.sleep(max(0.0, self._due_s - time.monotonic()))


def _serialise(recorded: list[RecordedMessage]) -> float:
    """Return what rosbags takes to serialise the same messages, CPU seconds."""
    store = codec.typestore()
    ready = [(store.deserialize_cdr(m.data, m.ros_type), m.ros_type) for m in recorded]
    began_s = time.process_time()
    for message, ros_type in ready:
        store.serialize_cdr(message, ros_type, little_endian=True)
    return time.process_time() - began_s


class _Memory:
    """Resident memory once a second; the first fifth, in which caches fill, is left out."""

    def __init__(self) -> None:
        self._rss_mb: list[float] = []

    def sample(self) -> None:
        statm = Path("/proc/self/statm").read_text(encoding="ascii")
        self._rss_mb.append(int(statm.split()[1]) * _PAGE_MB)

    def figures(self) -> dict[str, object]:
        """Return level, slope and noise of the resident memory."""
        settled = np.array(self._rss_mb[len(self._rss_mb) // 5 :])
        seconds = np.arange(settled.size)
        slope, start = np.polyfit(seconds, settled, 1)
        left_over = settled - (start + slope * seconds)
        return {
            "rss_mb_mean": round(float(settled.mean()), 1),
            "rss_mb_max": round(float(settled.max()), 1),
            "rss_slope_mb_per_min": round(float(slope) * 60.0, 3),
            "rss_slope_error_mb_per_min": round(_slope_error(seconds, left_over) * 60.0, 3),
            "rss_noise_mb": round(float(np.std(left_over)), 2),
            "cpus": os.cpu_count(),
        }


def _slope_error(times: IntArray, left_over: FloatArray) -> float:
    """Return the slope's standard error; neighbours that are alike count as fewer values.

    An AR(1) process with correlation r of neighbours has (1 + r) / (1 - r) times the variance.
    """
    if not left_over.any():
        return 0.0
    spread = times - times.mean()
    error = np.sqrt((left_over**2).sum() / (times.size - 2) / (spread**2).sum())
    r = np.clip((left_over[1:] * left_over[:-1]).sum() / (left_over**2).sum(), 0.0, 0.99)
    return float(error * np.sqrt((1.0 + r) / (1.0 - r)))


if __name__ == "__main__":
    main()
