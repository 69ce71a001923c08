"""Where a recording comes from: which host, which boot; that is, whose clock its times are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from acquisition.clocks.clock_sample import ClockSample
from acquisition.editing.intact_recording import IntactRecording
from acquisition.errors import StreamError
from acquisition.files import written_name
from acquisition.messages import codec
from acquisition.stream.provenance import METADATA_NAME

CLOCK_TOPIC = "/clock"


@dataclass(frozen=True, slots=True)
class Origin:
    """One recording.

    Attributes:
        file: its name.
        host: the host that recorded it; "" where it does not say.
        boot_id: the boot during which; "" where it does not say.
        start_ns: log time of its first message.
        end_ns: log time of its last message.
        messages: how many it holds.
    """

    file: str
    host: str
    boot_id: str
    start_ns: int
    end_ns: int
    messages: int


def origin_of(recording: IntactRecording) -> Origin:
    """Return where a recording comes from.

    Raises:
        StreamError: it is damaged.
    """
    records = {record.name: record.metadata for record in recording.metadata()}
    statistics = recording.statistics
    return Origin(
        file=written_name(recording.path),
        host=records.get(METADATA_NAME, {}).get("host", ""),
        boot_id=_boot_id(recording),
        start_ns=statistics.message_start_time,
        end_ns=statistics.message_end_time,
        messages=statistics.message_count,
    )


def _boot_id(recording: IntactRecording) -> str:
    """Return what the first clock sample says."""
    for found in recording.messages(topics=[CLOCK_TOPIC]):
        row = codec.find(CLOCK_TOPIC, found.schema.name if found.schema else "")
        if row is None:
            return ""
        message = found.message
        try:
            sample = codec.decode(
                row, message.data, log_time_ns=message.log_time, sequence=message.sequence
            )
        except StreamError:
            return ""  # somebody else's /clock
        return sample.boot_id if isinstance(sample, ClockSample) else ""
    return ""


def clock_notes(origins: Sequence[Origin]) -> tuple[str, ...]:
    """Return what is to be known of times that come from several clocks, one line each."""
    notes = []
    for what, found in (
        ("hosts", {origin.host for origin in origins}),
        ("boots", {origin.boot_id for origin in origins}),
    ):
        named = sorted(found - {""})
        if len(named) > 1:
            notes.append(
                f"recorded by {len(named)} {what} ({', '.join(named)}): the log times are those "
                "of each, and were not aligned with each other"
            )
    return tuple(notes)
