"""Profile files: the shipped ones, and what is said of faulty ones."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from drivers.errors import DriverError
from drivers.vibration.decode import FrameDecoder
from drivers.vibration.frames import FrameParser
from drivers.vibration.profile import check_profile, load_profile, shipped_profiles

_SHIPPED = Path(__file__).parents[2] / "drivers" / "vibration" / "profiles"


def _edited(tmp_path: Path, *edits: tuple[str, str], base: str = "aft601d") -> Path:
    """Write a shipped profile with some of its text replaced."""
    text = (_SHIPPED / f"{base}.toml").read_text()
    for old, new in edits:
        assert old in text, f"the test edits what is not there: {old}"
        text = text.replace(old, new, 1)
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return path


def _line(path: Path, beginning: str) -> int:
    return 1 + next(i for i, t in enumerate(path.read_text().splitlines()) if beginning in t)


@pytest.mark.parametrize("name", shipped_profiles())
def test_a_shipped_profile_has_no_fault_and_carries_its_own_name(name: str) -> None:
    assert check_profile(_SHIPPED / f"{name}.toml") == []
    assert load_profile(name).profile.name == name
    assert load_profile(name) == load_profile(_SHIPPED / f"{name}.toml")


def test_the_assumed_profile_says_so() -> None:
    profile = load_profile("aft601d")
    assert not profile.profile.verified
    assert "assumed" in profile.profile.device
    assert "# ASSUMED." in (_SHIPPED / "aft601d.toml").read_text()


def test_a_profile_cannot_be_changed_after_it_is_read() -> None:
    with pytest.raises(ValidationError):
        load_profile("aft601d").serial.baud = 9600


def test_every_malformed_key_is_reported_at_once_with_its_line(tmp_path: Path) -> None:
    path = _edited(
        tmp_path,
        ("baud = 115200", 'baud = "fast"'),
        ('parity = "none"', 'parity = "sometimes"'),
        ("stop_bits = 1", "stop_bits = 1\nstart_bits = 1"),
        ('sync = "AA 55"', 'sync = "AA 5"'),
        ('type = "int16"', 'type = "int17"'),
        ('statistic = "peak"\n', ""),
    )
    problems = check_profile(path)
    assert [(p.line, p.found) for p in problems] == [
        (_line(path, "baud ="), "baud = 'fast'"),
        (_line(path, "parity ="), "parity = 'sometimes'"),
        (_line(path, "start_bits ="), "unknown key 'start_bits' in serial"),
        (_line(path, "sync ="), "sync = 'AA 5'"),
        (_line(path, 'type = "int17"'), "type = 'int17'"),
        (_line(path, "[sample]"), "no 'statistic' in sample"),
    ]
    assert str(problems[1]) == (
        f"{path}:{_line(path, 'parity =')}: found parity = 'sometimes', "
        "expected 'none', 'even' or 'odd', do: correct the value"
    )


def test_nothing_is_converted_silently(tmp_path: Path) -> None:
    path = _edited(
        tmp_path, ("verified = false", 'verified = "no"'), ("length = 22", "length = 22.0")
    )
    assert [p.line for p in check_profile(path)] == [
        _line(path, "verified ="),
        _line(path, "length ="),
    ]


@pytest.mark.parametrize(
    ("base", "old", "new", "line", "found"),
    [
        ("aft601d", 'mode = "stream"', 'mode = "poll"', "mode =", "without [poll]"),
        ("wtvb01-485", 'mode = "poll"', 'mode = "stream"', "[poll]", "[poll] in mode 'stream'"),
        ("wtvb01-485", "17 08 4A", "17 08 4B", "request =", "CRC 08 4B"),
        ("wtvb01-485", "reply_length = 7", "reply_length = 3", "[[start]]", "reply_length 3"),
        ("aft601d", "length = 22\n", "\n", "[frame]", "both or neither"),
        ("aft601d", "span = [0, -2]", "span = [0, 40]", "span =", "span at byte 40"),
        ("aft601d", "offset = -2", "offset = -1", "offset = -1", "offset at byte -1"),
        ("aft601d", "offset = -2\n", "\n", "[frame.checksum]", "missing"),
        ("aft601d", "offset = 2\n", "offset = 1\n", "offset = 1", "bytes 1 to 4"),
        ("aft601d", "offsets = [18]", "offsets = [19]", "offsets = [19]", "bytes 19 to 20"),
        ("aft601d", "scale = 0.1", "scale = 0", "scale = 0", "scale 0"),
        ("aft601d", "min = -55.0", "min = 555.0", "min = 555", "min 555.0"),
        (
            "aft601d",
            'name = "frequency"',
            'name = "displacement"',
            'name = "displacement"',
            "second",
        ),
        (
            "aft601d",
            'temperature = "temperature"',
            'temperature = "heat"',
            '= "heat"',
            "not defined",
        ),
        ("aft601d", 'quantity = "displacement"', 'quantity = "velocity"', "amplitude =", "in m"),
        ("aft601d", 'axes = ["x", "y", "z"]', 'axes = ["x", "x", "z"]', "axes =", "axes"),
        ("aft601d", "band_hz = [5.0, 500.0]", "band_hz = [500.0, 5.0]", "band_hz =", "band"),
        ("aft601d", "band_hz = [5.0, 500.0]\n", "", "[sample]", "one of frequency and band_hz"),
        ("wtvb01-bt50", "following_syncs = 1", "", "[frame]", "following_syncs = 0"),
        ("wtvb01-bt50", 'm = "none"', 'm = "none"\noffset = 1', "algorithm", "with other keys"),
        ("aft601d", "length = 22", "length = 22\nfollowing_syncs = 1", "following", "beside a"),
        ("wtvb01-bt50", 'sync = "55 61"', 'sync = "55"', "sync =", "a sync of 1 byte"),
        ("wtvb01-bt50", "min = -50.0\n", "", "[[field]]", "without min and max"),
    ],
)
def test_tables_that_disagree_are_reported_with_a_line(
    tmp_path: Path, base: str, old: str, new: str, line: str, found: str
) -> None:
    path = _edited(tmp_path, (old, new), base=base)
    problems = check_profile(path)
    assert any(found in p.found for p in problems), problems
    reported = {p.line for p in problems if found in p.found}
    text = path.read_text().splitlines()
    assert all(line in text[number - 1] for number in reported)


def test_a_length_in_the_frame_needs_sensible_limits(tmp_path: Path) -> None:
    table = (
        '[frame.length_field]\noffset = 2\ntype = "uint8"\nbyte_order = "big"\n'
        "add = 3\nmin = 30\nmax = 22\n"
    )
    path = _edited(tmp_path, ("length = 22\n", f"\n{table}"))
    assert [p.found for p in check_profile(path)] == ["min 30"]


def test_without_a_checksum_polling_and_varying_lengths_are_refused(tmp_path: Path) -> None:
    path = _edited(
        tmp_path,
        ('algorithm = "crc16-modbus"', 'algorithm = "none"'),
        ("length = 51", ""),
        base="wtvb01-485",
    )
    found = [p.found for p in check_profile(path)]
    assert "no checksum in mode 'poll'" in found
    assert "no checksum, variable length" in found


_ODD_VALUES = [
    "-1",
    "0",
    "1e400",
    "nan",
    "70000",
    '""',
    '"float32"',
    "[]",
    "[0, 0, 0]",
    "{}",
    "true",
]


@settings(max_examples=100, deadline=None)
@given(data=st.data(), name=st.sampled_from(shipped_profiles()))
def test_whatever_is_in_a_profile_it_is_reported_or_it_works(
    data: st.DataObject, name: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    lines = (_SHIPPED / f"{name}.toml").read_text().splitlines()
    for _ in range(data.draw(st.integers(1, 3))):
        number = data.draw(st.integers(0, len(lines) - 1))
        key, equals, _ = lines[number].partition("=")
        lines[number] = f"{key}= {data.draw(st.sampled_from(_ODD_VALUES))}" if equals else ""
    path = tmp_path_factory.mktemp("profile") / "odd.toml"
    path.write_text("\n".join(lines))
    problems = check_profile(path)
    assert all(1 <= problem.line <= len(lines) for problem in problems)
    if not problems:
        profile = load_profile(path)
        FrameParser(profile).feed(data.draw(st.binary()) + profile.frame.sync * 60)
        FrameDecoder(profile).decode(bytes([255]) * profile.frame.shortest)


def test_broken_toml_is_reported_with_its_line(tmp_path: Path) -> None:
    path = _edited(tmp_path, ("baud = 115200", "baud ="))
    (problem,) = check_profile(path)
    assert problem.line == _line(path, "baud =")
    assert problem.expected == "valid TOML"


def test_loading_a_faulty_profile_names_the_first_fault_in_one_line(tmp_path: Path) -> None:
    path = _edited(tmp_path, ("baud = 115200", "baud = 0"), ("data_bits = 8", "data_bits = 9"))
    with pytest.raises(DriverError, match=r"mine\.toml:\d+: found baud = 0.*\(and 1 more\)$"):
        load_profile(path)


@pytest.mark.parametrize("name", ["aft602d", "no/such/file.toml", ".", "../drivers/samples"])
def test_a_profile_that_does_not_exist_is_refused_with_the_names_of_those_that_do(
    name: str,
) -> None:
    with pytest.raises(DriverError, match=r"no vibration profile .*aft601d, wtvb01-485"):
        check_profile(name)
