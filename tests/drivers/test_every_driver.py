"""What every driver promises, checked for every kind in the table of devices."""

from __future__ import annotations

import dataclasses
import sys
import typing
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.errors import DriverError
from drivers.samples import Sample
from drivers.source import SOURCES, Source, make_source

# Kind -> constructor arguments of a device that is not there; `nowhere` is a path without a file.
# A kind without a line here fails.
NOT_THERE: Mapping[str, Callable[[Path], dict[str, object]]] = {
    "gyro": lambda nowhere: {"bus": str(nowhere)},
    "wheels": lambda nowhere: {"interface": "slcan", "channel": str(nowhere)},
    "mocap": lambda nowhere: {"body": "rover", "system": "nonexistent"},
    "tum": lambda nowhere: {"folder": nowhere, "intrinsics_px": (500.0, 500.0, 320.0, 240.0)},
    "png": lambda nowhere: {
        "folder": nowhere,
        "intrinsics_px": (500.0, 500.0, 320.0, 240.0),
        "rate_hz": 30.0,
    },
    "vibration": lambda nowhere: {"port": str(nowhere)},
    "openni": lambda nowhere: {"file": nowhere / "missing.oni"},
}

# A field says its unit at the end of its name, or stands here with the reason.
UNITS = ("ns", "m", "mm", "px", "s", "hz", "rad", "rad_s", "m_s", "m_s2", "c", "counts", "ticks")
UNITLESS = {
    "sequence": "a counter",
    "amplitude": "m, m/s or m/s^2 as its quantity says",
    "quantity": "a word",
    "statistic": "a word",
    "quat_wxyz": "a unit quaternion, whose order is the name's end",
    "covariance": "mixed units, stated in the docstring",
    "camera": "a record whose own fields have units",
    "arbitration_id": "a number on the bus",
    "is_extended": "yes or no",
    "is_remote": "yes or no",
    "is_error": "yes or no",
    "data": "bytes",
    "channel": "a name",
}

KINDS = sorted(SOURCES)
SAMPLE_TYPES = typing.get_args(Sample)

IO_EVENTS = ("open", "os.", "socket.", "subprocess.", "fcntl.", "ctypes.")
_audited: list[str] = []
_auditing = False


def _audit(event: str, _arguments: object) -> None:
    if _auditing and event.startswith(IO_EVENTS):
        _audited.append(event)


sys.addaudithook(_audit)


@contextmanager
def audited() -> Iterator[list[str]]:
    """Yield the list of input and output events of Python that happen inside."""
    global _auditing  # an audit hook cannot be removed, only switched
    _audited.clear()
    _auditing = True
    try:
        yield _audited
    finally:
        _auditing = False


@pytest.fixture(params=KINDS)
def make(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[], Source]:
    """Return a constructor of the kind's absent device."""
    kind = request.param
    if kind not in NOT_THERE:
        pytest.fail(f"device kind {kind!r} is not visited: add its arguments to NOT_THERE")
    settings = NOT_THERE[kind](tmp_path / "nowhere")
    return lambda: make_source(kind, **settings)


def test_constructing_touches_nothing(make: Callable[[], Source]) -> None:
    make()  # imports the module, which opens its files
    with audited() as events:
        make()
    assert events == []


def test_the_name_is_not_empty(make: Callable[[], Source]) -> None:
    assert make().name


def test_nothing_has_gone_wrong_before_open(make: Callable[[], Source]) -> None:
    faults = make().faults
    assert not faults.losses() + faults.repairs()


def test_closing_what_was_never_open_is_harmless(make: Callable[[], Source]) -> None:
    source = make()
    source.close()
    source.close()


def test_reading_before_open_names_the_source(make: Callable[[], Source]) -> None:
    source = make()
    with pytest.raises(DriverError, match=f"{source.name}.*not open"):
        source.read(0.0)


def test_opening_what_is_not_there_names_the_source_and_leaves_nothing(
    make: Callable[[], Source],
) -> None:
    source = make()
    for _ in range(2):
        with pytest.raises(DriverError, match=source.name) as caught:
            source.open()
        assert "\n" not in str(caught.value)
    with pytest.raises(DriverError, match="not open"):
        source.read(0.0)
    source.close()


@pytest.mark.parametrize("sample_type", SAMPLE_TYPES, ids=lambda t: t.__name__)
def test_samples_are_frozen_and_stamped_in_integer_nanoseconds(sample_type: type) -> None:
    assert dataclasses.is_dataclass(sample_type)
    assert sample_type.__dataclass_params__.frozen  # type: ignore[attr-defined] # not in typeshed
    assert "__slots__" in vars(sample_type)
    assert typing.get_type_hints(sample_type)["t_ns"] is int
    assert typing.get_type_hints(sample_type)["sequence"] is int


@pytest.mark.parametrize("sample_type", SAMPLE_TYPES, ids=lambda t: t.__name__)
def test_fields_of_samples_tell_their_units_and_are_documented(sample_type: type) -> None:
    for field in dataclasses.fields(sample_type):
        has_unit = field.name.endswith(tuple(f"_{unit}" for unit in UNITS))
        assert has_unit or field.name in UNITLESS, f"{field.name}: which unit?"
        assert f"        {field.name}: " in (sample_type.__doc__ or ""), f"{field.name}: no text"
