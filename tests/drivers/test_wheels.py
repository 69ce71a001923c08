"""The wheel driver over python-can and slcan on a pseudo-terminal."""

from __future__ import annotations

import itertools
import struct
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import can
import pytest

from drivers.errors import DriverError
from drivers.samples import CanFrameSample, WheelTwistSample
from drivers.source import OpenSource
from drivers.wheels.can_wheels import Wheels
from tests.fakes.fake_time import FakeTime
from tests.fakes.slcan_pty import SlcanPty, frame_line

PUMA_SPEED = 0x02021540
TwistOrFrame = CanFrameSample | WheelTwistSample


@pytest.fixture
def adapter(tmp_path: Path) -> Iterator[SlcanPty]:
    with SlcanPty(tmp_path / "ttyCAN", seed=7) as pty:
        yield pty


def slcan_wheels(adapter: SlcanPty, fake_time: FakeTime | None = None) -> Wheels:
    return Wheels(
        str(adapter.path),
        interface="slcan",
        bus_options={"sleep_after_open": 0},
        clock=fake_time or time.monotonic_ns,
        sleep=fake_time.sleep if fake_time else time.sleep,
    )


def puma_line(device: int, shaft_rpm: float) -> bytes:
    """A Puma's speed: signed 16.16 fixed point, little-endian, of the motor shaft."""
    return frame_line(
        PUMA_SPEED | device, struct.pack("<i", round(shaft_rpm * 65536)), extended=True
    )


def pump_and_read(adapter: SlcanPty, wheels: Wheels) -> list[TwistOrFrame]:
    """Let everything out and read it as fast as it goes."""
    samples: list[TwistOrFrame] = []
    waiting = 1
    while waiting:
        waiting = adapter.pump()
        samples += wheels.read(0.05)
    while more := wheels.read(0.01):
        samples += more
    return samples


def frames_of(samples: Sequence[TwistOrFrame]) -> list[CanFrameSample]:
    return [s for s in samples if isinstance(s, CanFrameSample)]


def twists_of(samples: Sequence[TwistOrFrame]) -> list[WheelTwistSample]:
    return [s for s in samples if isinstance(s, WheelTwistSample)]


def test_twenty_thousand_frames_are_decoded_without_loss(adapter: SlcanPty) -> None:
    sets = 5000
    adapter.feed(puma_line(device, n + device / 8) for n in range(sets) for device in (2, 3, 5, 4))
    # Stamps from a clock that stands still: however the machine stalls, no set is too slow.
    with OpenSource(wheels := slcan_wheels(adapter, FakeTime())) as source:
        assert source.info is not None
        assert source.info.produces == (CanFrameSample, WheelTwistSample)
        assert adapter.is_streaming
        assert "S6" in adapter.commands, "500 kbit/s"
        started_s = time.perf_counter()
        samples = pump_and_read(adapter, wheels)
        elapsed_s = time.perf_counter() - started_s
    frames, twists = frames_of(samples), twists_of(samples)
    assert [f.sequence for f in frames] == list(range(4 * sets))
    assert [struct.unpack("<i", f.data)[0] / 65536 for f in frames] == [
        n + device / 8 for n in range(sets) for device in (2, 3, 5, 4)
    ]
    assert [t.sequence for t in twists] == list(range(sets))
    assert wheels.bus_counters.garbled == 0
    # Shaft rpm over gear 24 on wheels of 0.098 m; mean of both wheels of a side.
    rim_m_s_per_rpm = 2 * 3.141592653589793 / 60 * 0.098 / 24
    assert twists[100].left_m_s == pytest.approx((100 + 2.5 / 8) * rim_m_s_per_rpm)
    assert twists[100].right_m_s == pytest.approx((100 + 4.5 / 8) * rim_m_s_per_rpm)
    assert 4 * sets / elapsed_s > 1000, "a bus of 1 kHz must be kept up with"


def test_frames_are_stamped_by_the_host_in_order(adapter: SlcanPty) -> None:
    before_ns = time.monotonic_ns()
    with OpenSource(wheels := slcan_wheels(adapter)):
        adapter.feed(puma_line(2, 0.0) for _ in range(200))
        samples = pump_and_read(adapter, wheels)
    stamps_ns = [s.t_ns for s in samples]
    assert stamps_ns == sorted(stamps_ns)
    assert before_ns < stamps_ns[0] <= stamps_ns[-1] < time.monotonic_ns()


GARBLED_LINES = [
    b"tXYZ2AABB\r",  # identifier that is no number: python-can raises ValueError
    b"t12\r",  # cut off: python-can raises IndexError
    b"t1238112233\r",  # fewer bytes than it says: python-can returns it
    b"tFFF0\r",  # there is no 11-bit identifier 0xFFF
    b"T0202154X400000000\r",
    b"t1231G\xff\r",
]


def test_garbled_lines_are_counted_and_cost_nothing_else(adapter: SlcanPty) -> None:
    good = [puma_line(2, n) for n in range(2000)]
    lines = list(good)
    for position in range(1900, 0, -100):
        lines.insert(position, GARBLED_LINES[position // 100 % len(GARBLED_LINES)])
    adapter.feed(lines)
    with OpenSource(wheels := slcan_wheels(adapter)):
        frames = frames_of(pump_and_read(adapter, wheels))
    assert len(frames) == len(good)
    assert wheels.bus_counters.garbled == 19
    assert wheels.faults.losses() == ["19 garbled frames"]


def test_noise_inside_the_stream_costs_only_the_lines_that_it_hit(adapter: SlcanPty) -> None:
    lines = [puma_line(2, n) for n in range(2000)]
    for n in range(50, 2000, 100):
        lines[n] = adapter.garbage(1 + n // 50) + lines[n]
    adapter.feed(lines)
    with OpenSource(wheels := slcan_wheels(adapter)):
        frames = frames_of(pump_and_read(adapter, wheels))
    assert len(frames) == 2000 - 20
    rpm = [struct.unpack("<i", f.data)[0] // 65536 for f in frames]
    assert rpm == [n for n in range(2000) if n % 100 != 50]


def test_unplugging_is_named_and_replugging_is_used_again(adapter: SlcanPty) -> None:
    fake_time = FakeTime()
    wheels = slcan_wheels(adapter, fake_time)
    sequence = itertools.count()
    with OpenSource(wheels):
        for _ in range(100):
            adapter.feed([puma_line(2, 1.0), puma_line(3, 1.0)])
            for frame in frames_of(pump_and_read(adapter, wheels)):
                assert frame.sequence == next(sequence)
            adapter.unplug()
            for _ in range(2):
                with pytest.raises(DriverError, match=r"wheels: slcan:.*/ttyCAN: .*plugged in"):
                    wheels.read(0.01)
            adapter.replug()
            replugged_ns = fake_time()
            wheels.read(0.0)
            assert adapter.is_streaming
            assert fake_time() - replugged_ns <= 2e9
    assert next(sequence) == 200


def test_a_port_in_use_is_refused_and_free_again_after_close(adapter: SlcanPty) -> None:
    first, second = slcan_wheels(adapter), slcan_wheels(adapter)
    with OpenSource(first), pytest.raises(DriverError, match="Resource temporarily unavailable"):
        second.open()
    with OpenSource(second):
        adapter.feed([puma_line(2, 1.0)] * 3)
        assert [f.sequence for f in frames_of(pump_and_read(adapter, second))] == [0, 1, 2]
    with OpenSource(second):
        adapter.feed([puma_line(2, 1.0)])
        assert [f.sequence for f in frames_of(pump_and_read(adapter, second))] == [0]


class DyingBus:
    """A bus of python-can that fails right behind two frames."""

    def __init__(self, **_settings: object) -> None:
        self.waiting = [can.Message(arbitration_id=n, is_extended_id=False) for n in (1, 2)]
        self.is_shut_down = False

    def fileno(self) -> int:
        raise NotImplementedError

    def recv(self, timeout: float) -> can.Message:
        if not self.waiting:
            raise can.CanOperationError("Network is down")
        return self.waiting.pop(0)

    def shutdown(self) -> None:
        self.is_shut_down = True


def test_frames_before_a_failure_are_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = DyingBus()
    monkeypatch.setattr(can, "Bus", lambda **settings: bus)
    with OpenSource(wheels := Wheels("can0", interface="virtual")):
        assert [f.arbitration_id for f in frames_of(wheels.read(0.1))] == [1, 2]
        assert not bus.is_shut_down
        with pytest.raises(DriverError, match="the bus is gone: Network is down"):
            wheels.read(0.1)
        assert bus.is_shut_down


def test_a_missing_adapter_says_what_to_do(tmp_path: Path) -> None:
    wheels = Wheels(str(tmp_path / "ttyACM9"), interface="slcan")
    with pytest.raises(DriverError, match=r"wheels: slcan:.*ttyACM9: cannot open the bus: .*plug"):
        wheels.open()


def test_an_unknown_kind_of_bus_is_refused() -> None:
    with pytest.raises(DriverError, match=r"cannot open the bus: CAN interface 'nonsense' not"):
        Wheels("can77", interface="nonsense").open()


def test_a_missing_socketcan_interface_names_the_command() -> None:
    with pytest.raises(DriverError, match=r"ip link set can77 up type can bitrate 250000"):
        Wheels("can77", interface="socketcan", bitrate=250_000).open()


@pytest.mark.parametrize("library", ["can", "cantools.database"])
def test_a_missing_library_names_the_extra(library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(DriverError, match=r"pip install 'terravibe\[wheels\]'"):
        Wheels("x", interface="virtual").open()
