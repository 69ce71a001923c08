"""Kill the recorder at random moments: what is lost, what is readable, what `recover` restores.

    python -m benchmarks.recorder_kill --kills 100 --json kills.json

What is lost is counted from the last stamp that any source had taken when the kill came to the
last log time that is read back. The bar is 100 ms. Each file must be readable without damage,
and what `recover` makes of it must have an index and counts that mcap itself agrees with.
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from mcap.reader import make_reader

from acquisition.recovery.container import Container
from acquisition.recovery.recover import recover
from acquisition.stream.byte_source import FinishedFile
from benchmarks.recorder_victim import SLOT, SOURCES

BAR_MS = 100.0
_ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    """Kill, read, print, and write the figures to a file where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--kills", type=int, default=100, help="default 100")
    parser.add_argument("--seed", type=int, default=1, help="of the moments")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parser.parse_args()
    moments = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as folder:
        lost_ms = [
            kill_once(Path(folder), number, moments.uniform(0.3, 1.5))
            for number in range(arguments.kills)
        ]
    lost_ms.sort()
    figures = {
        "kills": len(lost_ms),
        "lost_ms_median": round(lost_ms[len(lost_ms) // 2], 1),
        "lost_ms_max": round(lost_ms[-1], 1),
        "bar_ms": BAR_MS,
    }
    print(json.dumps(figures, indent=2))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2))
    sys.exit(lost_ms[-1] > BAR_MS)


def kill_once(folder: Path, number: int, after_s: float) -> float:
    """Kill a recorder so long after its first sample; return what is lost, ms.

    Raises:
        RuntimeError: the file has damage, no message of some source can be read, or its recovery
            lacks messages or an index.
    """
    out, stamps = folder / f"{number}.mcap", folder / f"{number}.stamps"
    stamps.write_bytes(bytes(SLOT.size * SOURCES))
    command = [sys.executable, "-m", "benchmarks.recorder_victim", str(out), str(stamps)]
    with subprocess.Popen(command, cwd=_ROOT) as victim:
        while not all(last_stamps(stamps)) and victim.poll() is None:
            time.sleep(0.005)
        time.sleep(after_s)
        victim.kill()
    taken_ns = max(last_stamps(stamps))
    kept_ns, counts = what_is_left(out)
    check_recovery(out, counts)
    out.unlink()
    return (taken_ns - kept_ns) * 1e-6


def last_stamps(stamps: Path) -> list[int]:
    """Return the last log time that each source has stamped; 0 = none yet."""
    return [value for (value,) in SLOT.iter_unpack(stamps.read_bytes())]


def what_is_left(path: Path) -> tuple[int, Counter[str]]:
    """Return the latest log time that can be read back, and the number of messages by topic.

    Raises:
        RuntimeError: the file has damage, or fewer topics than there are sources.
    """
    counts: Counter[str] = Counter()
    last_ns = 0
    with FinishedFile(path) as file:
        container = Container(file)
        for message in container:
            counts[message.topic] += 1
            last_ns = max(last_ns, message.log_time_ns)
    if container.damaged or len(counts) < SOURCES:
        raise RuntimeError(f"{path}: {container.damaged}, topics {sorted(counts)}")
    return last_ns, counts


def check_recovery(path: Path, counts: Counter[str]) -> None:
    """Recover the file, and let mcap's own reader find all of it by the index.

    Raises:
        RuntimeError: it does not.
    """
    recovered = path.with_suffix(".recovered.mcap")
    recover(path, recovered)
    with recovered.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        if summary is None or summary.statistics is None or not summary.chunk_indexes:
            raise RuntimeError(f"{recovered}: no index")
        told = {
            summary.channels[number].topic: count
            for number, count in summary.statistics.channel_message_counts.items()
        }
        found = Counter(channel.topic for _, channel, _ in reader.iter_messages())
    recovered.unlink()
    if not told == dict(found) == dict(counts):
        raise RuntimeError(f"{recovered}: counts {told}, messages {found}, before {counts}")


if __name__ == "__main__":
    main()
