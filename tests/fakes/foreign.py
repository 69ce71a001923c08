"""Recordings as other programs write them: any topics, any options of mcap's own writer."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

from mcap.writer import Writer

from acquisition.messages import codec

INFO, IMAGE, POSE = "/depth/camera_info", "/depth/image", "/mocap/pose"


def parts(sample: Any, topics: Sequence[str] = (INFO, IMAGE, POSE)) -> list[tuple[str, bytes, int]]:
    """Return topic, CDR and time of the messages of a sample that are on those topics."""
    return [(m.topic, m.cdr, sample.t_ns) for m in codec.encode(sample) if m.topic in topics]


def foreign(
    content: Sequence[tuple[str, bytes, int]],
    rename: dict[str, str] | None = None,
    encoding: str = "cdr",
    **options: Any,
) -> bytes:
    """Return a recording as another program writes it."""
    stream = io.BytesIO()
    writer = Writer(stream, **options)
    writer.start("ros2")
    channels = {}
    for row in codec.MESSAGE_TYPES:
        schema = writer.register_schema(row.ros_type, "ros2msg", b"not looked at")
        topic = (rename or {}).get(row.topic, row.topic)
        channels[row.topic] = writer.register_channel(topic, encoding, schema)
    for topic, cdr, time_ns in content:
        writer.add_message(channels[topic], time_ns, cdr, time_ns)
    writer.finish()
    return stream.getvalue()
