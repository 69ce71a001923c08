"""When a frame ended, reckoned from when the bytes were read.

The clock is read once, right after each read returned. If the frame's last byte is the last of
that read, the frame has that time; a frame with bytes behind it is older:

    streaming:  age = whole frames behind * period
                      + (period - frame on the wire + rest on the wire, if there is a rest)
    polled:     age = bytes behind on the wire

A stream's device is silent between frames, so the beginning of the next frame shows that the
pause is over. Bytes count whether or not they turned out to be frames, so a damaged frame in a
batch takes its period too. The latency of the USB adapter is not in the bytes and not removed.
"""

from __future__ import annotations

from collections import deque


class ArrivalTimes:
    """Remembers when bytes were read, for as long as frames may still end among them."""

    def __init__(self, byte_ns: float, period_ns: float | None) -> None:
        """Take the time of a byte on the wire, and the period of a stream; None when polled."""
        self._byte_ns = byte_ns
        self._period_ns = period_ns
        self._reads: deque[tuple[int, int]] = deque()  # (end position, time of the read)
        self._end = 0
        self._last_ns = -1

    def note(self, count: int, t_ns: int) -> None:
        """Remember that the next `count` bytes of the stream were read at `t_ns`."""
        self._end += count
        self._reads.append((self._end, t_ns))

    def forget_before(self, position: int) -> None:
        """Drop what is known of the bytes in front of a stream position."""
        while self._reads and self._reads[0][0] <= position:
            self._reads.popleft()

    def stamp(self, end: int, length: int) -> int:
        """Return the time, ns, at which the frame of `length` bytes before `end` was complete.

        Frames must be asked for in the order of the stream; times strictly increase.
        """
        self.forget_before(end - 1)
        read_end, read_ns = self._reads[0]
        t_ns = read_ns - round(self._age_ns(read_end - end, length))
        self._last_ns = max(t_ns, self._last_ns + 1)
        return self._last_ns

    def _age_ns(self, behind: int, length: int) -> float:
        if self._period_ns is None:
            return behind * self._byte_ns
        frames, rest = divmod(behind, length)
        pause_ns = max(0.0, self._period_ns - length * self._byte_ns)
        return frames * self._period_ns + (pause_ns + rest * self._byte_ns if rest else 0.0)
