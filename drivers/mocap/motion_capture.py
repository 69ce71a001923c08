"""Pose of one rigid body from a motion capture system, through the library `motioncapture`.

The library runs in a process of its own (`mocap_child`), because its calls can neither be timed out
nor interrupted. So `read` keeps its time-out and `close` ends at once, whatever the server does.
"""

from __future__ import annotations

import importlib.util
import json
import math
import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from drivers.checks import check_not_negative, check_positive
from drivers.errors import DriverError
from drivers.faults import Faults
from drivers.samples import PoseSample, frozen_array
from drivers.source import SourceInfo

_CHILD = Path(__file__).with_name("child.py")
_READ_BYTES = 65536


class MotionCapture:
    """A `Source` of `PoseSample`.

    The world is that of the motion capture system; its z axis has to point up.

    Args:
        body: name of the rigid body, as in the motion capture software.
        name: how errors and records call this system.
        system: the library's name: optitrack, vicon, qualisys, nokov, vrpn, ..., or mock.
        hostname: address of the server; the library's default when empty.
        options: further settings of that system; it takes them as text.
        position_sigma_m: standard deviation of each coordinate.
        rotation_sigma_rad: standard deviation of the rotation about each axis.
        open_timeout_s: how long `open` waits for the server and the first pose.
        stall_timeout_s: the longest time without a frame, and without the body.
        clock: CLOCK_MONOTONIC in nanoseconds.

    Raises:
        DriverError: a number makes no sense.
    """

    def __init__(
        self,
        body: str,
        *,
        name: str = "mocap",
        system: str = "optitrack",
        hostname: str = "",
        options: Mapping[str, object] | None = None,
        position_sigma_m: float = 0.001,
        rotation_sigma_rad: float = 0.005,
        open_timeout_s: float = 5.0,
        stall_timeout_s: float = 1.0,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        check_not_negative(f"{name}: position_sigma_m", position_sigma_m)
        check_not_negative(f"{name}: rotation_sigma_rad", rotation_sigma_rad)
        check_positive(f"{name}: open_timeout_s", open_timeout_s)
        check_positive(f"{name}: stall_timeout_s", stall_timeout_s)
        self._body = body
        self._name = name
        self._system = system
        self._options = {key: str(value) for key, value in (options or {}).items()}
        if hostname:
            self._options["hostname"] = hostname
        variances = [position_sigma_m**2] * 3 + [rotation_sigma_rad**2] * 3
        self._covariance = frozen_array(np.diag(variances), (6, 6))
        self._open_timeout_s = open_timeout_s
        self._stall_timeout_s = stall_timeout_s
        self._clock = clock
        self._child: subprocess.Popen[bytes] | None = None
        self._pipe = -1
        self._is_open = False
        self._rest = b""
        self._sequence = 0
        self._frames_without_body = 0
        self._seen: list[str] = []
        self._first_frame_ns: int | None = None  # since the connection was started
        self._frame_ns = self._pose_ns = 0

    @property
    def name(self) -> str:
        """The instance's name."""
        return self._name

    @property
    def faults(self) -> Faults:
        """Frames of the server that did not have the body, since construction."""
        return Faults({"frames_without_body": self._frames_without_body})

    def open(self) -> SourceInfo:
        """Connect and wait for the first pose of the body.

        Raises:
            DriverError: the library is missing, the server does not answer, or it does not see
                the body; the message says which bodies it sees.
        """
        self.close()
        if importlib.util.find_spec("motioncapture") is None:
            raise self._error("motioncapture is not installed; pip install 'terravibe[mocap]'")
        self._sequence = 0
        self._start()
        try:
            self._wait_for_first_pose()
        except DriverError:
            self._stop()
            raise
        self._is_open = True
        return SourceInfo(
            name=self._name,
            model=f"motioncapture {self._system}",
            serial="",
            produces=(PoseSample,),
            time_base="monotonic",
            details={"body": self._body, **self._options},
        )

    def read(self, timeout_s: float) -> Sequence[PoseSample]:
        """Return the poses that have arrived.

        After an error the next `read` goes on, with a new connection if the old one ended.

        Raises:
            DriverError: not open, the connection ended, no frame for `stall_timeout_s`, or frames
                without the body for as long.
        """
        if not self._is_open:
            raise DriverError(f"{self._name}: not open; call open() first")
        if self._child is None:
            self._start()
        samples = self._receive(min(timeout_s, self._stall_timeout_s))
        if not samples:
            self._check_stall()
        return samples

    def close(self) -> None:
        """End the connection; never blocks."""
        self._is_open = False
        self._stop()

    def _wait_for_first_pose(self) -> None:
        """Wait for the server's first frame, then a little for one that has the body."""
        deadline_ns = self._clock() + round(self._open_timeout_s * 1e9)
        while not self._receive(max(0.0, (deadline_ns - self._clock()) / 1e9)):
            if self._first_frame_ns is not None:
                patience_ns = round(self._stall_timeout_s * 1e9)
                deadline_ns = min(deadline_ns, self._first_frame_ns + patience_ns)
            if self._clock() >= deadline_ns:
                raise self._silent() if self._first_frame_ns is None else self._unseen()
        self._sequence = 0

    def _start(self) -> None:
        """Start the child process; it connects while we wait for its first line."""
        self._pipe, child_end = os.pipe()
        arguments = (str(child_end), self._system, json.dumps(self._options), self._body)
        try:
            self._child = subprocess.Popen(  # noqa: S603 - our own interpreter and our own script
                [sys.executable, "-P", str(_CHILD), *arguments, str(self._open_timeout_s)],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=(child_end,),
            )
        except OSError as error:
            self._stop()
            raise self._error(f"cannot start {_CHILD.name}: {error}") from error
        finally:
            os.close(child_end)
        self._rest = b""
        self._seen = []
        self._first_frame_ns = None
        self._frame_ns = self._pose_ns = self._clock()

    def _stop(self) -> int | None:
        """Kill the child process; return its exit code if it had ended before."""
        child, self._child = self._child, None
        if self._pipe >= 0:
            os.close(self._pipe)
            self._pipe = -1
        if child is None:
            return None
        code = child.poll()
        child.kill()
        child.communicate()  # reaps it and closes its standard input
        return code

    def _receive(self, timeout_s: float) -> list[PoseSample]:
        """Read what the child has written, waiting at most that long."""
        if not select.select([self._pipe], [], [], timeout_s)[0]:
            return []
        data = os.read(self._pipe, _READ_BYTES)
        if not data:
            code = self._stop()
            raise self._error(f"the connection ended (exit code {code}); is the server running?")
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [sample for line in lines if (sample := self._sample(line)) is not None]

    def _sample(self, line: bytes) -> PoseSample | None:
        """Return the body's pose in one frame; None when the frame has none."""
        message = json.loads(line)
        if "error" in message:
            self._stop()
            raise self._error(f"{message['error']}; check system, hostname and options")
        self._frame_ns = self._clock()
        self._first_frame_ns = self._first_frame_ns or self._frame_ns
        self._seen = message["seen"]
        pose = message["pose"]
        if pose is None:
            self._frames_without_body += 1
            return None
        self._pose_ns = self._frame_ns
        self._sequence += 1
        return PoseSample(
            t_ns=message["t_ns"],
            position_m=frozen_array(pose[:3], (3,)),
            # The library has float32; PoseSample promises a unit quaternion in float64.
            quat_wxyz=frozen_array(np.divide(pose[3:], math.hypot(*pose[3:])), (4,)),
            covariance=self._covariance,
            sequence=self._sequence - 1,
        )

    def _check_stall(self) -> None:
        """Raise DriverError when the frames or the body stayed away for `stall_timeout_s`."""
        now_ns = self._clock()
        limit_ns = self._stall_timeout_s * 1e9
        if now_ns - self._pose_ns <= limit_ns:
            return
        silent = now_ns - self._frame_ns > limit_ns
        self._pose_ns = now_ns  # so that the next error comes only after as long again
        raise self._silent() if silent else self._unseen()

    def _silent(self) -> DriverError:
        return self._error("no frames; is the server running and streaming to this host?")

    def _unseen(self) -> DriverError:
        seen = ", ".join(self._seen) or "no rigid body at all"
        return self._error(f"does not see rigid body {self._body!r}; it sees: {seen}")

    def _error(self, reason: str) -> DriverError:
        host = self._options.get("hostname")
        where = f"{self._system} at {host}" if host else self._system
        return DriverError(f"{self._name}: {where}: {reason}")
