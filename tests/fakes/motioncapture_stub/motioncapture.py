"""Stands in for the library `motioncapture` in the driver's child process, to misbehave.

Put this folder on PYTHONPATH. It fails as the library does with a real server: a call that blocks
without end, a body that disappears, a process that dies. Frames need no time here.

Not simulated: any real system's protocol. The library's own `mock` covers frames as such.
"""

from __future__ import annotations

import os
import signal
from types import SimpleNamespace


class _System:
    def __init__(self, options: dict[str, str]) -> None:
        self._options = options
        self._frames = 0
        self.rigidBodies: dict[str, SimpleNamespace] = {}

    def waitForNextFrame(self) -> None:  # noqa: N802 - the library's name
        if self._frames == int(self._options["frames"]):
            self._misbehave()
        self._frames += 1
        position = [float(self._frames), 2.0, 3.0]
        rotation = SimpleNamespace(w=2.0, x=0.0, y=0.0, z=0.0)
        self.rigidBodies = {
            "rover": SimpleNamespace(position=position, rotation=rotation),
            "lander": SimpleNamespace(position=[0.0] * 3, rotation=rotation),
        }
        if self._frames > int(self._options.get("rover_frames", "1000000")):
            del self.rigidBodies["rover"]
        elif self._frames > int(self._options.get("rover_finite_frames", "1000000")):
            self.rigidBodies["rover"].position = [float("nan")] * 3

    def _misbehave(self) -> None:
        if self._options["then"] == "crash":
            os.kill(os.getpid(), signal.SIGKILL)
        signal.pause()


def connect(_system: str, options: dict[str, str]) -> _System:
    if options.get("connect") == "hangs":
        signal.pause()
    return _System(options)
