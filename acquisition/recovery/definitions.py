"""Which schema and channel a number stands for, when some of the places that say so are damaged."""

from __future__ import annotations

from collections.abc import Iterable

from mcap.records import Channel, Schema


class Definitions:
    """Collects definitions from wherever they are found; what a checksum vouches for wins.

    A recording says everything up to three times: at top level, in a chunk, in the summary.

    Attributes:
        schemas: by number.
        channels: by number.
    """

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self._proven: set[tuple[type, int]] = set()

    def add(self, found: Iterable[object], *, proven: bool) -> None:
        """Take the definitions among some records; the first of equal standing counts."""
        for record in found:
            if isinstance(record, Schema) and self._wins(record, record.id in self.schemas, proven):
                self.schemas[record.id] = record
            if isinstance(record, Channel) and self._wins(
                record, record.id in self.channels, proven
            ):
                self.channels[record.id] = record

    def _wins(self, record: Schema | Channel, known: bool, proven: bool) -> bool:
        key = (type(record), record.id)
        if known and (not proven or key in self._proven):
            return False
        if proven:
            self._proven.add(key)
        return True

    def prove(self) -> None:
        """Note that a checksum vouches for everything that was added."""
        self._proven.update((Schema, number) for number in self.schemas)
        self._proven.update((Channel, number) for number in self.channels)

    def proves(self, channel_id: int) -> bool:
        """Tell whether a checksum vouches for what a channel is called and what it carries."""
        schema_id = self.channels[channel_id].schema_id
        schema_is_proven = schema_id == 0 or (Schema, schema_id) in self._proven
        return schema_is_proven and (Channel, channel_id) in self._proven

    def override(self, record: Schema | Channel) -> None:
        """Let a definition hold from here on, as readers do that go through a file in order."""
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        else:
            self.channels[record.id] = record
