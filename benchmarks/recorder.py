"""Full load on the recorder: drops, CPU, lateness of stamps, memory, and the bare writer beside it.

    python -m benchmarks.recorder --seconds 600 --json recorder.json

Prints for each recorded second: CPU of the process, of its fake devices alone, and of the bare
mcap writer that is given such messages. The bar is (process - fakes) / bare.

The bare writer is a loop over `mcap.writer.Writer.add_message` and nothing else: the bytes of 8 s
that were recorded just before, already serialised and in memory, closed into chunks as often (50
ms) and as large, with the same compression (zstd at the library's level) and checksums, into an
unbuffered file. It reads no device, stamps, numbers, counts, checks and synchronises nothing.
Fakes and floors are measured while the recorder runs, in processes of their own
(`benchmarks.recorder_floors` says why); of the writer's many passes the median counts:

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
import tempfile
import threading
import time
from array import array
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.recording.disk_output import DiskOutput
from acquisition.recording.folder_store import DiskSettings
from acquisition.recording.plan import RecordingPlan, RecordingResult
from acquisition.recording.recorder import Recorder
from acquisition.recording.source_worker import WorkerSettings
from acquisition.stream.open_part import PartLimits
from benchmarks.load import sources
from benchmarks.recorder_floors import Floor
from tests.fakes.paced_source import PacedSource

FloatArray = NDArray[np.float64]
BAR = 1.5
_BARE_SECONDS = 8.0
_KB_MB = 1024 / 1e6


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
    warm_up = folder / "warm_up.mcap"
    _record(warm_up, sources(), arguments, _BARE_SECONDS, _Memory(_BARE_SECONDS, 0.0))
    devices, memory = sources(), _Memory(seconds, arguments.split)
    fakes, bare = Floor("fakes"), Floor("bare", str(warm_up))
    with fakes, bare:
        result, process_s = _record(folder / "load.mcap", devices, arguments, seconds, memory)
    fakes_s, floor = fakes.figures["fakes"], bare.figures
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
        "bare_mcap_cpu_s_per_s": round(floor["bare"], 4),
        "bare_mcap_least_and_most": (round(floor["bare_least"], 4), round(floor["bare_most"], 4)),
        "paced_mcap_cpu_s_per_s": round(floor["paced"], 4),
        "bare_passes": floor["passes"],
        "serialise_cpu_s_per_s": round(floor["serialise"], 4),
        "ratio_to_bare": round(cost_s / floor["bare"], 3),
        "ratio_to_paced": round(cost_s / floor["paced"], 3),
        "ratio_to_bare_with_serialising": round(cost_s / (floor["bare"] + floor["serialise"]), 3),
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
    path: Path,
    devices: list[PacedSource],
    arguments: argparse.Namespace,
    seconds: float,
    memory: _Memory,
) -> tuple[RecordingResult, float]:
    """Record; return how it went, and CPU seconds for each second."""
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


class _Memory:
    """Resident memory once a second; the first fifth, in which caches fill, is left out.

    The slope is what parts have in common: a new part may begin with a step, and the level of
    each is a figure of its own, so that no growth from part to part can hide in it.
    """

    def __init__(self, seconds: float, split_s: float) -> None:
        # All the room there will be, so that the measuring itself does not grow.
        self._rss_mb = array("d", bytes(8 * int(seconds + 10)))
        self._samples = 0
        self._split_s = split_s or np.inf

    def sample(self) -> None:
        # Exact; the counters behind /proc/self/statm may be some dozen pages behind.
        rollup = Path("/proc/self/smaps_rollup").read_text(encoding="ascii")
        self._rss_mb[self._samples] = int(rollup.split("Rss:", 1)[1].split(None, 1)[0]) * _KB_MB
        self._samples += 1

    def figures(self) -> dict[str, object]:
        """Return level, slope and noise of the resident memory."""
        seconds = np.arange(self._samples // 5, self._samples)
        settled = np.array(self._rss_mb)[seconds]
        parts = np.floor(seconds / self._split_s)
        levels = (parts[:, None] == np.unique(parts)).astype(float)
        design = np.column_stack([seconds, levels])
        fit = np.linalg.lstsq(design, settled, rcond=None)[0]
        left_over = settled - design @ fit
        within = seconds - levels @ (levels.T @ seconds / levels.sum(axis=0))
        by_part = levels.T @ settled / levels.sum(axis=0)
        return {
            "rss_mb_max": round(float(settled.max()), 2),
            "rss_mb_by_part": np.round(by_part, 2).tolist(),
            "rss_slope_mb_per_min": round(float(fit[0]) * 60.0, 4),
            "rss_slope_error_mb_per_min": round(_slope_error(within, left_over) * 60.0, 4),
            "rss_noise_mb": round(float(np.std(left_over)), 3),
            "cpus": os.cpu_count(),
        }


def _slope_error(within: FloatArray, left_over: FloatArray) -> float:
    """Return the slope's standard error; neighbours that are alike count as fewer values.

    An AR(1) process with correlation r of neighbours has (1 + r) / (1 - r) times the variance.

    Args:
        within: time of each value from the middle of its part, s.
        left_over: what the fit leaves of it.
    """
    if np.ptp(left_over) < 1e-9:
        return 0.0
    error = np.sqrt((left_over**2).sum() / (within.size - 2) / (within**2).sum())
    r = np.clip((left_over[1:] * left_over[:-1]).sum() / (left_over**2).sum(), 0.0, 0.99)
    return float(error * np.sqrt((1.0 + r) / (1.0 - r)))


if __name__ == "__main__":
    main()
