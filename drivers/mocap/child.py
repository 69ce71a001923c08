"""Runs the motion capture library in a process of its own: `python mocap_child.py ARGUMENTS`.

The library cannot be interrupted: `connect` and `waitForNextFrame` block in C++ for as long as the
server says nothing, and may crash there. A process can be ended at any time; a thread cannot.

One JSON object a line goes to the given descriptor: {"error": text} and the end, or for every frame
{"t_ns": CLOCK_MONOTONIC after the frame, "seen": names, "pose": [x, y, z, qw, qx, qy, qz] or null}.
Standard output is not used because the library prints there.
"""

from __future__ import annotations

import faulthandler
import json
import math
import os
import sys
import threading
import time
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from collections.abc import Sequence


def main(arguments: Sequence[str]) -> None:
    """Connect and write frames until the parent goes away."""
    descriptor, system, options, body, connect_timeout_s = arguments
    threading.Thread(target=_end_with_the_parent, daemon=True).start()
    with os.fdopen(int(descriptor), "w") as out:
        try:
            import motioncapture

            # `connect` keeps the interpreter's lock, so only a C-level watchdog can end it.
            faulthandler.dump_traceback_later(float(connect_timeout_s), exit=True)
            source = motioncapture.connect(system, json.loads(options))
            faulthandler.cancel_dump_traceback_later()
            while True:
                source.waitForNextFrame()
                _send(out, _frame(time.monotonic_ns(), source.rigidBodies, body))
        except (ImportError, RuntimeError, ValueError) as error:
            _send(out, {"error": str(error)})


def _frame(t_ns: int, bodies: Any, name: str) -> dict[str, object]:  # noqa: ANN401 - the library has no types
    """Return one frame's message; a body without a finite pose is not seen."""
    seen, pose = set(bodies), None
    if name in seen:
        position, rotation = bodies[name].position, bodies[name].rotation
        pose = [*map(float, position), rotation.w, rotation.x, rotation.y, rotation.z]
        if not all(map(math.isfinite, pose)) or not any(pose[3:]):
            seen, pose = seen - {name}, None
    return {"t_ns": t_ns, "seen": sorted(seen), "pose": pose}


def _send(out: TextIO, message: dict[str, object]) -> None:
    out.write(json.dumps(message) + "\n")
    out.flush()


def _end_with_the_parent() -> None:
    """Standard input is a pipe from the parent that carries nothing: its end is the parent's."""
    sys.stdin.buffer.read()
    os._exit(0)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except BrokenPipeError:
        os._exit(0)
