"""Print how the drivers fare on their fakes: replugging, failing buses, damaged data.

    python -m benchmarks.drivers --json drivers.json

Takes about three minutes. The serial parser has a benchmark of its own, serial_parser.py. Ends
with exit code 1 when a figure misses its bar:

    replug  the error names the device, samples come within 2 s, no descriptor stays open
    storm   30 % of a gyro's transfers fail: no gap without its failures, no stall over the bound
    oni     90 frames pixel for pixel with their stamps; a killed helper and a truncated file are
            errors of one line
    can     20 000 frames at 1 kHz decoded without loss, with damaged lines between them
    fuzz    10 000 random strings for each parser: no exception but DriverError, nothing kept
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from benchmarks.driver_conversations import CanRun, Playback, Storm, can_run, playbacks, storms
from benchmarks.driver_fuzz import Fuzzing, fuzz_all
from benchmarks.driver_replug import Replugging, replug_all

_MOST_KEPT_KIB = 64.0

Row = Replugging | Storm | Playback | CanRun | Fuzzing


def main() -> None:
    """Measure, print, and write the figures to a file where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--cycles", type=int, default=100, help="of replugging; default 100")
    parser.add_argument("--strings", type=int, default=10_000, help="of each parser; default 10000")
    parser.add_argument("--can-frames", type=int, default=20_000, help="default 20000")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        figures = {
            "replug": _printed("replug", replug_all(arguments.cycles, folder)),
            "storm": _printed("storm", storms(3000, 4)),
            "oni": _printed("oni", playbacks(folder)),
            "can": _printed("can", [can_run(arguments.can_frames, folder)]),
            "fuzz": _printed("fuzz", fuzz_all(arguments.strings, folder)),
        }
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2))
    sys.exit(any(row["missed"] for rows in figures.values() for row in rows))


def _printed(title: str, rows: Iterable[Row]) -> list[dict[str, object]]:
    """Print each row as it comes; return them with whether they miss their bar."""
    print(f"== {title}")
    found = []
    for row in rows:
        figures = asdict(row) | {"missed": missed(row)}
        print("  ".join(f"{key}={_text(value)}" for key, value in figures.items()), flush=True)
        found.append(figures)
    return found


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def missed(row: Row) -> bool:
    """Tell whether a row misses the bar of its section."""
    match row:
        case Replugging():
            leaked = row.descriptors_after != row.descriptors_before
            return row.named != row.cycles or row.slowest_s > 2.0 or leaked
        case Storm():
            stall_s = max(row.longest_stall_s, row.stuck_stall_s)
            return row.unexplained_gaps > 0 or stall_s > row.bound_s
        case Playback():
            if row.damaged:
                ended = row.end.startswith("DriverError") and "\n" not in row.end
            else:
                ended = row.frames == 90 and row.end.startswith("EndOfSource")
            return not (ended and row.frames == row.equal_frames == row.equal_stamps)
        case CanRun():
            return row.received != row.sent or row.garbled != row.garbled_sent
        case Fuzzing():
            return row.others > 0 or row.grown_kib > _MOST_KEPT_KIB


if __name__ == "__main__":
    main()
