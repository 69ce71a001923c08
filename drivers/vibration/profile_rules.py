"""What must agree between the tables of a profile whose tables are each well formed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from drivers.toml_lines import KeyPath
from drivers.vibration.checksums import crc16_modbus
from drivers.vibration.profile_tables import ValueField, VibrationProfile

_UNIT_OF_QUANTITY = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2"}


@dataclass(frozen=True, slots=True)
class Finding:
    """One disagreement: where, what stands there, what was expected, what to do."""

    path: KeyPath
    found: str
    expected: str
    do: str


Rule = Callable[[VibrationProfile], Iterator[Finding]]


def findings(profile: VibrationProfile) -> list[Finding]:
    """Return everything in the profile that does not agree with the rest of it."""
    return [finding for rule in _RULES for finding in rule(profile)]


def _link(profile: VibrationProfile) -> Iterator[Finding]:
    polls = profile.link.mode == "poll"
    if polls and profile.poll is None:
        yield Finding(("link", "mode"), "mode 'poll' without [poll]", "a [poll] table", "add it")
    if not polls and profile.poll is not None:
        yield Finding(
            ("poll",), "[poll] in mode 'stream'", "no [poll] table", "remove it or set mode 'poll'"
        )
    if profile.poll and profile.poll.modbus and crc16_modbus(profile.poll.request):
        crc = crc16_modbus(profile.poll.request[:-2]).to_bytes(2, "little").hex(" ").upper()
        yield Finding(
            ("poll", "request"),
            f"CRC {profile.poll.request[-2:].hex(' ').upper()}",
            f"CRC {crc} for a Modbus request",
            "correct the bytes or set modbus = false",
        )
    for table in ("start", "stop"):
        for index, step in enumerate(getattr(profile, table)):
            if step.reply_length < len(step.reply):
                yield Finding(
                    (table, index),
                    f"reply of {len(step.reply)} bytes with reply_length {step.reply_length}",
                    "reply_length of the whole reply",
                    "set reply_length",
                )


def _length(profile: VibrationProfile) -> Iterator[Finding]:
    frame = profile.frame
    if (frame.length is None) == (frame.length_field is None):
        yield Finding(
            ("frame",),
            "both or neither of length and [frame.length_field]",
            "one of them",
            "keep the one that describes the device",
        )
    rule = frame.length_field
    if rule and rule.min > rule.max:
        yield Finding(
            ("frame", "length_field", "min"),
            f"min {rule.min}",
            f"at most max {rule.max}",
            "swap them",
        )


def _checksum(profile: VibrationProfile) -> Iterator[Finding]:
    frame, checksum = profile.frame, profile.frame.checksum
    path: KeyPath = ("frame", "checksum")
    if checksum.kind is None:
        yield from _without_checksum(profile)
        return
    if frame.following_syncs:
        yield Finding(
            ("frame", "following_syncs"),
            "following_syncs beside a checksum",
            "the checksum alone",
            "remove it",
        )
    if checksum.span is None or checksum.offset is None or checksum.byte_order is None:
        yield Finding(path, "span, offset or byte_order missing", "all three", "add them")
        return
    for name, value in (
        ("offset", checksum.offset),
        ("span", checksum.span[0]),
        ("span", checksum.span[1]),
    ):
        room = checksum.kind.size if name == "offset" else 0
        position = value if value >= 0 else frame.shortest + value
        if not 0 <= position <= frame.shortest - room:
            yield Finding(
                (*path, name),
                f"{name} at byte {value}",
                f"bytes inside a frame of {frame.shortest}",
                "correct the offset",
            )


def _without_checksum(profile: VibrationProfile) -> Iterator[Finding]:
    """Yield what is missing where only spacing and ranges can tell a frame from noise."""
    frame = profile.frame
    where: KeyPath = ("frame", "checksum", "algorithm")
    if frame.checksum.model_fields_set != {"algorithm"}:
        yield Finding(where, "algorithm 'none' with other keys", "no other keys", "remove them")
    if frame.length is None:
        yield Finding(where, "no checksum, variable length", "a fixed length", "set frame.length")
    if profile.link.mode == "poll":
        yield Finding(where, "no checksum in mode 'poll'", "a checksum", "use mode 'stream'")
    if len(frame.sync) < 2:
        yield Finding(
            ("frame", "sync"),
            f"a sync of {len(frame.sync)} byte without a checksum",
            "at least 2 bytes",
            "add the constant bytes that follow it",
        )
    if frame.following_syncs < 1:
        yield Finding(
            ("frame",),
            "following_syncs = 0 without a checksum",
            "at least 1",
            "set following_syncs = 1",
        )
    for index, field in enumerate(profile.field):
        if field.min is None or field.max is None:
            yield Finding(
                ("field", index),
                f"field {field.name!r} without min and max",
                "both where there is no checksum",
                "add what the device can send",
            )


def _fields(profile: VibrationProfile) -> Iterator[Finding]:
    seen: set[str] = set()
    for index, field in enumerate(profile.field):
        path: KeyPath = ("field", index)
        if field.name in seen:
            yield Finding(
                (*path, "name"), f"a second field {field.name!r}", "distinct names", "rename it"
            )
        seen.add(field.name)
        if field.scale == 0:
            yield Finding((*path, "scale"), "scale 0", "a scale that keeps the value", "correct it")
        if field.min is not None and field.max is not None and field.min >= field.max:
            yield Finding((*path, "min"), f"min {field.min}", f"less than max {field.max}", "swap")
        for offset in field.offsets:
            yield from _inside((*path, "offsets"), offset, field.size, profile)
    for index, part in enumerate(profile.clock.part if profile.clock else ()):
        yield from _inside(("clock", "part", index, "offset"), part.offset, part.size, profile)


def _inside(path: KeyPath, offset: int, size: int, profile: VibrationProfile) -> Iterator[Finding]:
    first, end = len(profile.frame.sync), profile.frame.shortest
    checksum = profile.frame.checksum
    if checksum.kind is not None and checksum.offset is not None and checksum.offset < 0:
        end += checksum.offset
    if not first <= offset <= end - size:
        yield Finding(
            path,
            f"bytes {offset} to {offset + size - 1}",
            f"bytes {first} to {end - 1}, between sync and checksum",
            "correct the offset or the length of the frame",
        )


def _sample(profile: VibrationProfile) -> Iterator[Finding]:
    sample = profile.sample
    roles = (
        ("amplitude", sample.amplitude, 3, _UNIT_OF_QUANTITY[sample.quantity]),
        ("frequency", sample.frequency, 3, "Hz"),
        ("temperature", sample.temperature, 1, "degC"),
        ("specific_force", sample.specific_force, 3, "m/s^2"),
    )
    for role, name, count, unit in roles:
        if name is not None:
            yield from _role(role, profile.field_named(name), name, count, unit)
    if sorted(axis[-1] for axis in sample.axes) != ["x", "y", "z"]:
        yield Finding(
            ("sample", "axes"), f"axes {list(sample.axes)}", "x, y and z once each", "correct them"
        )
    if (sample.frequency is None) != (sample.band_hz is None):
        yield Finding(
            ("sample",), "one of frequency and band_hz", "both or neither", "add the other"
        )
    if sample.band_hz and sample.band_hz[0] >= sample.band_hz[1]:
        yield Finding(
            ("sample", "band_hz"), f"band {list(sample.band_hz)}", "[low, high]", "swap them"
        )


def _role(
    role: str, field: ValueField | None, name: str, count: int, unit: str
) -> Iterator[Finding]:
    path: KeyPath = ("sample", role)
    if field is None:
        yield Finding(path, f"field {name!r}, not defined", "a [[field]] of that name", "add it")
    elif len(field.offsets) != count or field.unit != unit:
        yield Finding(
            path,
            f"field {name!r} with {len(field.offsets)} offsets in {field.unit}",
            f"{count} offsets in {unit}",
            "name another field or correct that one",
        )


_RULES: tuple[Rule, ...] = (_link, _length, _checksum, _fields, _sample)
