"""What the recorder's process and the process that holds libOpenNI2 say to each other.

They share a socket that keeps message boundaries and a memory file. To the parent go the messages
below as JSON. From the parent comes one byte, a slot's number, per slot that is free again; the
end of that stream is the order to stop. The memory file holds a counter of `COUNTER_BYTES` that
grows while the helper's main loop is alive, then `SLOTS` slots of one frame each, uint16
millimetres in the byte order of the machine.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

COUNTER_BYTES = 8
SLOTS = 8  # a quarter of a second at 30 frames per second
MAX_MESSAGE_BYTES = 65536


@dataclass(frozen=True, slots=True)
class HelperSettings:
    """What the helper is started with.

    Attributes:
        socket_fd: descriptor of the message socket.
        memory_fd: descriptor of the memory file, empty so far.
        library_folder: where libOpenNI2 is.
        device: what to open: a device's URI, a file's path, or "" for the first camera found.
        is_file: whether `device` is a recording.
        silence_s: the longest time without a frame.
    """

    socket_fd: int
    memory_fd: int
    library_folder: str
    device: str
    is_file: bool
    silence_s: float


@dataclass(frozen=True, slots=True)
class Ready:
    """The device is open and the memory file has its size.

    Attributes:
        vendor: who made the device, as OpenNI says.
        model: what it is called.
        uri: how OpenNI knows it.
        width_px: width of its frames.
        height_px: height of its frames.
        rate_hz: frames per second.
        fov_rad: horizontal and vertical field of view, None where it does not say.
        frames: number of frames of a recording, None for a device or where it does not say.
    """

    vendor: str
    model: str
    uri: str
    width_px: int
    height_px: int
    rate_hz: int
    fov_rad: Sequence[float] | None
    frames: int | None


@dataclass(frozen=True, slots=True)
class FrameNote:
    """A frame is in a slot.

    Attributes:
        slot: which one; it stays the parent's until given back.
        t_ns: CLOCK_MONOTONIC right after the frame was read.
        timestamp_us: the time stamp that OpenNI gives it.
        index: the frame counter that OpenNI gives it.
    """

    slot: int
    t_ns: int
    timestamp_us: int
    index: int


@dataclass(frozen=True, slots=True)
class End:
    """The recording has given its last frame."""


@dataclass(frozen=True, slots=True)
class Failure:
    """The helper gives up.

    Attributes:
        text: what was found, expected and to be done, to follow the device's name.
    """

    text: str


Message = Ready | FrameNote | End | Failure

_KINDS: Mapping[str, type[Message]] = {
    kind.__name__: kind for kind in (Ready, FrameNote, End, Failure)
}


def encode(message: Message) -> bytes:
    """Return a message as it goes through the socket."""
    return json.dumps({"kind": type(message).__name__, **asdict(message)}).encode()


def decode(data: bytes) -> Message:
    """Return the message that `encode` was given."""
    content = json.loads(data)
    return _KINDS[content.pop("kind")](**content)


def slot_offset(slot: int, width_px: int, height_px: int) -> int:
    """Return where in the memory file a slot starts, in bytes; slot `SLOTS` is its end."""
    return COUNTER_BYTES + slot * 2 * width_px * height_px
