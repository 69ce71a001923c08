"""The process that holds libOpenNI2, so that a crash or a hang in there stays in there.

Started by `drivers.depth.openni_link` as `python -m drivers.depth.openni_helper`, with
`HelperSettings` as JSON for its argument. It ends by `os._exit`: unloading the library crashes
with some drivers.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import queue
import socket
import struct
import sys
import threading
import time
from dataclasses import replace
from types import TracebackType

from drivers.depth.openni_camera import Camera, CameraError, explain
from drivers.depth.openni_protocol import (
    SLOTS,
    End,
    Failure,
    HelperSettings,
    Message,
    Ready,
    encode,
    slot_offset,
)

_WAIT_S = 0.1  # how often the counter grows when nothing arrives
_STOP_S = 2.0  # what closing the device may take


class ParentLink:
    """The helper's ends of the socket and of the shared memory."""

    def __init__(self, settings: HelperSettings) -> None:
        self.stopping = threading.Event()
        self._socket = socket.socket(fileno=settings.socket_fd)
        self._memory_fd = settings.memory_fd
        self._beats = 0
        self._free_slots: queue.SimpleQueue[int] = queue.SimpleQueue()
        for slot in range(SLOTS):
            self._free_slots.put(slot)

    def obey(self) -> None:
        """Take back slots until the parent closes its end, then stop; runs in a thread."""
        with contextlib.suppress(ConnectionError):
            while slot := self._socket.recv(1):
                self._free_slots.put(slot[0])
        self.stopping.set()
        time.sleep(_STOP_S)
        os._exit(1)  # the device does not close, or native code hangs

    def announce(self, ready: Ready) -> None:
        """Give the memory file its size and tell the parent."""
        size = slot_offset(SLOTS, ready.width_px, ready.height_px)
        os.ftruncate(self._memory_fd, size)
        self._memory = mmap.mmap(self._memory_fd, size)
        self.send(ready)

    def send(self, message: Message) -> None:
        """Send a message to the parent."""
        self._socket.send(encode(message))

    def beat(self) -> None:
        """Let the counter grow."""
        self._beats += 1
        struct.pack_into("=Q", self._memory, 0, self._beats)

    def free_slot(self, *, wait: bool) -> int | None:
        """Return the number of a free slot; without one None at once, or wait until the stop."""
        while not self.stopping.is_set():
            self.beat()
            with contextlib.suppress(queue.Empty):
                return self._free_slots.get(timeout=_WAIT_S if wait else 0)
            if not wait:
                break
        return None

    def fill(self, slot: int, pixels: bytes) -> None:
        """Copy a frame into a slot."""
        start = slot_offset(slot, 1, len(pixels) // 2)
        self._memory[start : start + len(pixels)] = pixels

    def report(
        self,
        kind: type[BaseException],  # noqa: ARG002 - the signature of sys.excepthook
        error: BaseException,
        traceback: TracebackType | None,  # noqa: ARG002
    ) -> None:
        """Tell the parent why the helper ends, and end."""
        with contextlib.suppress(ConnectionError):
            self.send(Failure(" ".join(explain(error).split())))
        os._exit(1)


def pass_on(camera: Camera, link: ParentLink, settings: HelperSettings, frames: int | None) -> None:
    """Give the camera's frames to the parent until it says stop or a recording ends.

    A live frame for which the parent has left no slot is dropped; a recording waits.

    Raises:
        CameraError: silent for too long.
    """
    given = 0
    last_frame_s = time.monotonic()
    while not link.stopping.is_set():
        link.beat()
        if not camera.wait(_WAIT_S):
            if time.monotonic() - last_frame_s > settings.silence_s:
                raise CameraError(_silence(settings, given, frames))
            continue
        note, pixels = camera.read()
        slot = link.free_slot(wait=settings.is_file)
        if slot is not None:
            link.fill(slot, pixels)
            link.send(replace(note, slot=slot))
        given += 1
        last_frame_s = time.monotonic()
        if note.index == frames:
            link.send(End())
            break


def _silence(settings: HelperSettings, given: int, frames: int | None) -> str:
    if settings.is_file:
        return (
            f"ends after {given} frames; expected {frames or 'an end mark'}, the recording is cut "
            "off or damaged, copy it again"
        )
    return (
        f"gave no frame for {settings.silence_s:g} s, and {given} before; expected 30 a second, "
        "check its plug and its 12 V supply"
    )


def main() -> None:
    """Run as a process of its own."""
    settings = HelperSettings(**json.loads(sys.argv[1]))
    link = ParentLink(settings)
    sys.excepthook = link.report
    threading.Thread(target=link.obey, daemon=True).start()
    camera = Camera(settings)
    ready = camera.describe()
    camera.start()
    link.announce(ready)  # from here on the parent expects signs of life
    pass_on(camera, link, settings, ready.frames)
    camera.close()
    os._exit(0)


if __name__ == "__main__":
    main()
