"""A minimal writer of OpenNI recordings, so that the real libOpenNI2 plays known pixels.

Format 1.0.1.0, all little-endian. The file starts with magic, version, largest time stamp and
largest node number. Then come records: a header of 28 bytes (magic, type, node, length of header
and fields, length of the payload, position of the record that undoes this one), fields, payload.
One depth node, frames uncompressed. Not simulated: compression, colour and infrared, the seek
table (the driver never seeks).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

_NODE = 1
_DEPTH_NODE_TYPE = 2
_DEPTH_1_MM = 100
_INT, _GENERAL, _REMOVED, _DATA_BEGIN, _READY, _DATA, _END, _ADDED = 3, 6, 7, 8, 9, 10, 11, 12


def _record(kind: int, fields: bytes = b"", payload: bytes = b"") -> bytes:
    header = struct.pack("<4s4IQ", b"NIR", kind, _NODE, 28 + len(fields), len(payload), 0)
    return header + fields + payload


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text) + 1) + text.encode() + b"\0"


def _property(kind: int, name: str, value: bytes) -> bytes:
    return _record(kind, _text(name) + struct.pack("<I", len(value)) + value)


def write_oni(
    path: Path,
    frames_mm: Sequence[np.ndarray],
    stamps_us: Sequence[int],
    *,
    fov_rad: tuple[float, float] | None = None,
) -> None:
    """Write (height, width) uint16 frames at 30 frames per second nominal."""
    height, width = frames_mm[0].shape
    last_us = max(stamps_us)
    records = [
        _record(
            _ADDED,
            _text("Depth")
            + struct.pack("<I4sIQQ", _DEPTH_NODE_TYPE, b"NONE", len(frames_mm), 0, last_us),
        ),
        _property(_GENERAL, "xnMapOutputMode", struct.pack("<3I", width, height, 30)),
        _property(_INT, "oniPixelFormat", struct.pack("<Q", _DEPTH_1_MM)),
        _property(_GENERAL, "xnCropping", struct.pack("<I4H", 0, 0, 0, 0, 0)),
        _property(_INT, "xnDeviceMaxDepth", struct.pack("<Q", 10000)),
    ]
    if fov_rad is not None:
        records.append(_property(_GENERAL, "xnFOV", struct.pack("<2d", *fov_rad)))
    records += [
        _record(_READY),
        _record(_DATA_BEGIN, struct.pack("<IQ", len(frames_mm), last_us)),
    ]
    for number, (frame, stamp_us) in enumerate(zip(frames_mm, stamps_us, strict=True), start=1):
        pixels = frame.astype("<u2").tobytes()
        records.append(_record(_DATA, struct.pack("<QI", stamp_us, number), pixels))
    records += [_record(_REMOVED), _record(_END)]
    header = struct.pack("<4sBBHIQI", b"NI10", 1, 0, 1, 0, last_us, _NODE)
    path.write_bytes(header + b"".join(records))
