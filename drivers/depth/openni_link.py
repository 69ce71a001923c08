"""The recorder's side of the helper process that holds libOpenNI2."""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.depth.openni_protocol import (
    MAX_MESSAGE_BYTES,
    SLOTS,
    End,
    Failure,
    FrameNote,
    HelperSettings,
    Message,
    Ready,
    decode,
    slot_offset,
)
from drivers.errors import DriverError

_LOOK_S = 0.25  # how often a silent helper is looked at
_EXIT_S = 3.0  # told to stop, the helper ends itself after 2 s, whatever native code does


class OpenNiLink:
    """A running helper, from its start to its certain end.

    Constructing starts a new interpreter; this process is not forked, so its threads do not
    matter. The text of every DriverError is to follow the device's name.

    Args:
        library_folder: where libOpenNI2 is.
        device: a URI, a file's path, or "" for the first camera found.
        is_file: whether `device` is a recording.
        silence_s: the longest time without a frame.
        stall_s: the longest time without a sign of life of the helper.

    Raises:
        DriverError: the process cannot be started.
    """

    def __init__(
        self, library_folder: Path, device: str, *, is_file: bool, silence_s: float, stall_s: float
    ) -> None:
        self._is_file = is_file
        self._stall_s = stall_s
        self._ready: Ready | None = None
        self._memory: mmap.mmap | None = None
        self._beats = 0
        self._alive_s = 0.0
        with contextlib.ExitStack() as resources:
            try:
                self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                resources.callback(self._socket.close)
                with theirs:
                    self._memory_fd = os.memfd_create("terravibe-depth")
                    resources.callback(os.close, self._memory_fd)
                    self._process = _start(
                        HelperSettings(
                            socket_fd=theirs.fileno(),
                            memory_fd=self._memory_fd,
                            library_folder=str(library_folder),
                            device=device,
                            is_file=is_file,
                            silence_s=silence_s,
                        )
                    )
            except OSError as error:
                raise DriverError(
                    f"needs a helper process that cannot be started: {error}; expected free memory "
                    "and file descriptors, close something"
                ) from error
            self._resources = resources.pop_all()

    def wait_ready(self, timeout_s: float) -> Ready:
        """Return what the helper has opened.

        Raises:
            DriverError: it could not, or not in time; `stop` is still to be called.
        """
        message = self._receive(timeout_s)
        if not isinstance(message, Ready):
            self._process.kill()  # it would not notice a friendlier request
            raise DriverError(
                f"did not open within {timeout_s:g} s; expected an answer, unplug it and plug it "
                "in again"
            )
        self._memory = mmap.mmap(
            self._memory_fd, slot_offset(SLOTS, message.width_px, message.height_px)
        )
        self._ready = message
        self._alive_s = time.monotonic()
        return message

    def next_frame(
        self, timeout_s: float, step: int
    ) -> tuple[FrameNote, NDArray[np.uint16]] | End | None:
        """Return the next frame as a copy, None after `timeout_s` seconds, or the end.

        Args:
            timeout_s: how long to wait.
            step: 1 for all pixels, 2 for every second pixel of every second row.

        Raises:
            DriverError: the helper failed, crashed or hangs; `stop` is still to be called.
        """
        message = self._receive(timeout_s)
        if not isinstance(message, FrameNote) or self._ready is None or self._memory is None:
            return message if isinstance(message, End) else None
        width_px, height_px = self._ready.width_px, self._ready.height_px
        offset = slot_offset(message.slot, width_px, height_px)
        flat = np.frombuffer(self._memory, np.uint16, width_px * height_px, offset)
        depth_mm = flat.reshape(height_px, width_px)[::step, ::step].copy()
        with contextlib.suppress(ConnectionError):  # if it died, the next call tells
            self._socket.send(bytes([message.slot]))
        return message, depth_mm

    def stop(self) -> None:
        """End the helper and release everything; harmless when done before."""
        self._socket.close()  # the order to stop
        self._end_process()
        if self._memory is not None:
            self._memory.close()
        self._resources.close()

    def _receive(self, timeout_s: float) -> Message | None:
        deadline_s = time.monotonic() + timeout_s
        while True:
            left_s = max(deadline_s - time.monotonic(), 0.0)
            self._socket.settimeout(min(left_s, _LOOK_S))
            try:
                data = self._socket.recv(MAX_MESSAGE_BYTES)
            except (TimeoutError, BlockingIOError):
                self._look_for_life()
                if left_s == 0.0:
                    return None
                continue
            except ConnectionResetError:  # ended with slots unread; what it sent is still to come
                continue
            if not data:
                raise DriverError(self._cause_of_death())
            message = decode(data)
            if isinstance(message, Failure):
                raise DriverError(message.text)
            return message

    def _look_for_life(self) -> None:
        """Raise DriverError when the helper's counter has stood still for too long."""
        if self._memory is None:
            return
        (beats,) = struct.unpack_from("=Q", self._memory)
        now_s = time.monotonic()
        if beats != self._beats:
            self._beats, self._alive_s = beats, now_s
        elif now_s - self._alive_s > self._stall_s:
            self._process.kill()  # waiting for its own end would be in vain
            raise DriverError(
                f"hangs in libOpenNI2 for more than {self._stall_s:g} s; expected a sign of life "
                "every 0.1 s, close it and open it again, or plug it in again"
            )

    def _end_process(self) -> int:
        """Wait for the helper to end, end it if need be, and return its status."""
        try:
            return self._process.wait(_EXIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def _cause_of_death(self) -> str:
        status = self._end_process()
        signals = {entry.value: entry.name for entry in signal.Signals}
        cause = f"ended by {signals.get(-status)}" if status < 0 else f"exit code {status}"
        advice = (
            "the recording is probably damaged, copy it again"
            if self._is_file
            else "open it again and, if this repeats, update libOpenNI2 and its driver"
        )
        return f"lost its helper process ({cause}); expected it to live until the close, {advice}"


def _start(settings: HelperSettings) -> subprocess.Popen[bytes]:
    """Start the helper in a session of its own, so that Ctrl-C reaches the recorder alone."""
    search_path = os.pathsep.join(entry or str(Path.cwd()) for entry in sys.path)
    return subprocess.Popen(  # noqa: S603 - this interpreter, our own module
        [sys.executable, "-P", "-m", "drivers.depth.openni_helper", json.dumps(asdict(settings))],
        env={**os.environ, "PYTHONPATH": search_path},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,  # FreenectDriver prints a lot
        stderr=subprocess.DEVNULL,
        pass_fds=(settings.socket_fd, settings.memory_fd),
        start_new_session=True,
    )
