"""What `recover` saves of damaged recordings, beside what mcap's own readers give.

    python benchmarks/recovery.py [--seconds 20] [--json FILE]

The recording is made of the full load's topics at their rates with small images. "index" is
mcap's `make_reader`, "stream" a copy with mcap's `StreamReader`; both check checksums. A message
counts as saved when the original holds it, and as wrong otherwise.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from acquisition.recovery.recover import recover
from tests.fakes.damage import DAMAGES, Told, by_index, by_stream, unpacked
from tests.fakes.recordings import recording, samples

COLUMNS = "{:<22}{:>10}{:>10}{:>10}{:>10}{:>8}{:>10}{:>9}"


def compare(data: bytes, truth: Counter[Told], folder: Path) -> dict[str, float]:
    """Return the figures of one damaged recording."""
    damaged, output = folder / "damaged.mcap", folder / "saved.mcap"
    damaged.write_bytes(data)
    start_s = time.perf_counter()
    report = recover(damaged, output)
    elapsed_s = time.perf_counter() - start_s
    saved = Counter(unpacked(output.read_bytes()))
    return {
        "original": truth.total(),
        "index": _intact(by_index(damaged), truth),
        "stream": _intact(by_stream(damaged), truth),
        "recover": (saved & truth).total(),
        "wrong": (saved - truth).total(),
        "skipped_bytes": report.skipped_bytes,
        "seconds": elapsed_s,
    }


def _intact(messages: Iterable[Told], truth: Counter[Told]) -> int:
    return (Counter(messages) & truth).total()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="length of the recording")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments = parser.parse_args()
    intact = recording(samples(arguments.seconds))
    truth = Counter(unpacked(intact))
    figures: dict[str, dict[str, float]] = {}
    print(f"{len(intact)} bytes, {truth.total()} messages")
    names = ("original", "index", "stream", "recover", "wrong", "skipped B", "s")
    print(COLUMNS.format("damage", *names))
    with tempfile.TemporaryDirectory() as folder:
        for name, damage in {"none": lambda data: data, **DAMAGES}.items():
            row = figures[name] = compare(damage(intact), truth, Path(folder))
            *numbers, seconds = row.values()
            print(COLUMNS.format(name, *map(int, numbers), f"{seconds:.2f}"))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
