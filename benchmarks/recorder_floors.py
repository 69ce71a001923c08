"""What the load of `benchmarks.recorder` costs without a recorder, measured while that runs.

    python -m benchmarks.recorder_floors fakes
    python -m benchmarks.recorder_floors bare RECORDING

On a machine that others share, the same work takes half as much CPU again when the neighbours are
busy; so the floors run beside the recorder, each in a process of its own, and see the same
neighbours. Both say "ready", begin when a line comes on standard input, go on until that is
closed, and print JSON. They take the machine's time, not the recorder's.
"""

from __future__ import annotations

import json
import select
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from statistics import median
from typing import BinaryIO, Self

from mcap.writer import Writer

from acquisition.messages import codec
from acquisition.recovery.container import Container, RecordedMessage
from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.writer import CHUNK_SIZE_BYTES
from benchmarks.load import sources
from tests.fakes.paced_source import PacedSource

_FLUSH_NS = 50_000_000
_PAUSE_S = 12.0


class Floor:
    """One such process; a context manager that ends it."""

    def __init__(self, *arguments: str) -> None:
        """Start it and wait until it is ready."""
        command = [sys.executable, "-m", "benchmarks.recorder_floors", *arguments]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._pipes = self._process.stdin, self._process.stdout
        if not self._pipes[1] or self._pipes[1].readline() != "ready\n":
            raise RuntimeError(f"{command} did not start")

    def __enter__(self) -> Self:
        """Begin to measure."""
        if self._pipes[0]:
            self._pipes[0].write("go\n")
            self._pipes[0].flush()
        return self

    def __exit__(self, *_error: object) -> None:
        """End the measurement; `figures` has it."""
        output = self._process.communicate()[0]
        self.figures: dict[str, float] = json.loads(output)


def main() -> None:
    """Measure one floor until standard input is closed."""
    match sys.argv[1:]:
        case ["fakes"]:
            figures = _fakes()
        case ["bare", path]:
            figures = _bare_beside(Path(path))
        case _:
            raise SystemExit(__doc__)
    print(json.dumps(figures))


def _wait_for_go() -> None:
    print("ready", flush=True)
    sys.stdin.readline()


def _fakes() -> dict[str, float]:
    """Return what the fake devices cost when nobody records them, CPU seconds for each second."""
    stop = threading.Event()

    def live(device: PacedSource) -> None:
        """Read a device until the end, and drop what it gives."""
        device.open()
        while not stop.is_set():
            device.read(0.1)

    threads = [threading.Thread(target=live, args=(device,)) for device in sources()]
    _wait_for_go()
    began_s, cpu_s = time.monotonic(), time.process_time()
    for thread in threads:
        thread.start()
    sys.stdin.read()
    figures = {"fakes": (time.process_time() - cpu_s) / (time.monotonic() - began_s)}
    stop.set()
    for thread in threads:
        thread.join()
    return figures


def _bare_beside(path: Path) -> dict[str, float]:
    """Return the medians of the bare writer's runs, in CPU seconds for each recorded second."""
    messages, seconds = _recorded(path)
    bare, paced = [], []
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        file = Path(folder, "bare.mcap")
        _bare(messages, file, Counted)  # which fills the caches of Python
        _wait_for_go()
        over = False
        while not over:
            bare.append(_bare(messages, file, Counted) / seconds)
            paced.append(_bare(messages, file, Paced) / seconds)
            over = bool(select.select([sys.stdin], [], [], _PAUSE_S)[0])
    figures = {"bare": median(bare), "bare_least": min(bare), "bare_most": max(bare)}
    return {**figures, "paced": median(paced), "passes": len(bare), "seconds": seconds} | {
        "serialise": _serialise(messages) / seconds
    }


def _recorded(path: Path) -> tuple[list[RecordedMessage], float]:
    """Return the messages of a recording, and how many seconds they cover."""
    with FinishedFile(path) as file:
        found = list(Container(file))
    return found, (found[-1].log_time_ns - found[0].log_time_ns) * 1e-9


def _bare(messages: list[RecordedMessage], path: Path, wrap: type[Counted]) -> float:
    """Write the messages with mcap alone, flushed as often; return CPU seconds."""
    with path.open("wb", buffering=0) as file:
        began_s = time.process_time()
        _write_bare(wrap(file), messages)
        return time.process_time() - began_s


def _write_bare(file: Counted, messages: list[RecordedMessage]) -> None:
    writer = Writer(file, chunk_size=CHUNK_SIZE_BYTES)  # type: ignore[arg-type] # it uses write, tell and flush only
    writer.start("ros2")
    channels: dict[str, int] = {}
    for row in codec.MESSAGE_TYPES:
        text = codec.schema_text(row.ros_type).encode()
        schema = writer.register_schema(row.ros_type, "ros2msg", text)
        channels[row.topic] = writer.register_channel(row.topic, "cdr", schema)
    flushed_ns = messages[0].log_time_ns
    for message in messages:
        time_ns = message.log_time_ns
        channel = channels[message.topic]
        writer.add_message(channel, time_ns, message.data, time_ns, message.sequence)
        if time_ns - flushed_ns >= _FLUSH_NS:
            writer.flush()
            flushed_ns = time_ns
    writer.finish()


class Counted:
    """A raw file with a position that costs no system call, which is to mcap's advantage."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._length = 0

    def write(self, data: bytes) -> int:
        """Write and count."""
        self._length += len(data)
        return self._file.write(data)

    def tell(self) -> int:
        """Return what was counted."""
        return self._length

    def flush(self) -> None:
        """Flush the file."""
        self._file.flush()


class Paced(Counted):
    """Sleeps at each flush until the next one is due."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file)
        self._due_s = time.monotonic()

    def flush(self) -> None:
        """Flush the file and sleep."""
        super().flush()
        self._due_s += _FLUSH_NS * 1e-9
        time.sleep(max(0.0, self._due_s - time.monotonic()))


def _serialise(messages: list[RecordedMessage]) -> float:
    """Return what rosbags takes to serialise the same messages, CPU seconds."""
    store = codec.typestore()
    ready = [(store.deserialize_cdr(m.data, m.ros_type), m.ros_type) for m in messages]
    began_s = time.process_time()
    for message, ros_type in ready:
        store.serialize_cdr(message, ros_type, little_endian=True)
    return time.process_time() - began_s


if __name__ == "__main__":
    main()
