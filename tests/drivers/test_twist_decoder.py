"""CAN frames to vehicle twists: published formats, incomplete sets, layouts of one's own."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DriverError
from drivers.samples import CanFrameSample, WheelTwistSample
from drivers.wheels.twist_decoder import TwistDecoder
from drivers.wheels.vehicle_layout import VEHICLES, vehicle_layout

MS = 1_000_000
OWN_DBC = """VERSION ""
BU_: ECU
BO_ 256 Sides: 8 ECU
 SG_ Left : 0|32@1- (1,0) [0|0] "km/h" ECU
 SG_ Right : 32|32@1- (1,0) [0|0] "km/h" ECU
BO_ 258 Paged: 3 ECU
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" ECU
 SG_ Left m0 : 8|16@1- (1,0) [0|0] "mm/s" ECU
 SG_ Right m1 : 8|16@1- (1,0) [0|0] "mm/s" ECU
SIG_VALTYPE_ 256 Left : 1;
SIG_VALTYPE_ 256 Right : 1;
"""
OWN_LAYOUT: Mapping[str, object] = {"left": ["Sides.Left"], "right": ["Sides.Right"]}


def frame(
    arbitration_id: int, data: bytes, *, t_ns: int = 0, extended: bool = True
) -> CanFrameSample:
    return CanFrameSample(t_ns, arbitration_id, extended, False, False, data, "test", 0)


def puma_frame(device: int, shaft_rpm: float, *, t_ns: int = 0) -> CanFrameSample:
    data = struct.pack("<i", round(shaft_rpm * 65536))
    return frame(0x02021540 | device, data, t_ns=t_ns)


def puma(*, window_s: float = 0.02, changes: Mapping[str, object] | None = None) -> TwistDecoder:
    return TwistDecoder(vehicle_layout("puma", changes or {}), window_s)


@pytest.fixture
def own_dbc(tmp_path: Path) -> str:
    path = tmp_path / "own.dbc"
    path.write_text(OWN_DBC)
    return str(path)


def feed(decoder: TwistDecoder, *frames: CanFrameSample) -> list[WheelTwistSample]:
    return [twist for f in frames if (twist := decoder.add(f)) is not None]


def test_puma_bytes_of_four_wheels_become_one_twist() -> None:
    # 240 rpm of the shaft = 0x00F00000 in 16.16, little-endian 0000F000; over gear 24 that is
    # 10 rpm of the wheel, on 0.098 m 0.102625 m/s. The right wheels run three times as fast.
    # Effective track 1.5 x 0.37559 m: (0.307876 - 0.102625) / 0.563385 = 0.364317 rad/s.
    decoder = puma()
    left, right = bytes.fromhex("0000f000"), bytes.fromhex("0000d002")
    twists = feed(
        decoder,
        frame(0x02021542, left),
        frame(0x02021545, right),
        frame(0x02021543, left),
        frame(0x02021544, right),
    )
    (sample,) = twists
    assert (sample.left_m_s, sample.right_m_s) == pytest.approx((0.1026254, 0.3078761))
    assert sample.speed_m_s == pytest.approx(0.2052507)
    assert sample.yaw_rate_rad_s == pytest.approx(0.3643171)
    # var v = s^2/2, var w = 2 s^2/B_e^2 + (k w)^2 with s = 0.02 m/s and k = 0.1
    assert sample.speed_sigma_m_s == pytest.approx(0.0141421, rel=1e-5)
    assert sample.yaw_rate_sigma_rad_s == pytest.approx(math.hypot(0.0502046, 0.0364317), rel=1e-5)


def test_scout_bytes_become_a_twist() -> None:
    # 0x221: +500 mm/s = 01F4, -250 mrad/s = FF06, big-endian
    decoder = TwistDecoder(VEHICLES["scout_v2"], 0.02)
    (sample,) = feed(decoder, frame(0x221, bytes.fromhex("01f4ff0600000000"), extended=False))
    assert (sample.speed_m_s, sample.yaw_rate_rad_s) == pytest.approx((0.5, -0.25))
    assert (sample.left_m_s, sample.right_m_s) == (None, None)


def test_scout_odometer_and_29_bit_namesakes_give_no_twist() -> None:
    decoder = TwistDecoder(VEHICLES["scout_v2"], 0.02)
    assert not feed(decoder, frame(0x311, bytes(8), extended=False), frame(0x221, bytes(8)))


def test_a_request_without_data_is_not_an_answer() -> None:
    decoder = puma()
    assert not feed(decoder, frame(0x02021542, b""))
    assert decoder.counters.undecodable == 0


def test_a_mirrored_wheel_is_turned_round() -> None:
    decoder = puma(changes={"left": ["PumaSpeed2.Speed"], "right": ["-PumaSpeed5.Speed"]})
    (sample,) = feed(decoder, puma_frame(2, 100.0), puma_frame(5, -100.0))
    assert sample.yaw_rate_rad_s == pytest.approx(0.0)
    assert sample.speed_m_s > 0


def test_a_vehicles_own_yaw_rate_can_be_scaled() -> None:
    decoder = TwistDecoder(vehicle_layout("scout_v2", {"yaw_rate_scale": 0.7}), 0.02)
    (sample,) = feed(decoder, frame(0x221, bytes.fromhex("0000006400000000"), extended=False))
    assert sample.yaw_rate_rad_s == pytest.approx(0.07)


# --- sets ---------------------------------------------------------------------------------------


def test_a_twist_carries_the_time_of_its_newest_frame() -> None:
    decoder = puma()
    twists = feed(decoder, *(puma_frame(d, 1.0, t_ns=d * MS) for d in (2, 3, 4, 5)))
    assert [t.t_ns for t in twists] == [5 * MS]


def test_a_value_is_used_once() -> None:
    decoder = puma()
    feed(decoder, *(puma_frame(d, 1.0) for d in (2, 3, 4, 5)))
    assert not feed(decoder, *(puma_frame(d, 1.0) for d in (2, 3, 4)))
    assert decoder.missing == "PumaSpeed5.Speed"


def test_of_two_values_of_a_wheel_the_newer_counts() -> None:
    decoder = puma(changes={"left": ["PumaSpeed2.Speed"], "right": ["PumaSpeed5.Speed"]})
    (sample,) = feed(decoder, puma_frame(2, 100.0), puma_frame(2, 200.0), puma_frame(5, 200.0))
    assert sample.left_m_s == sample.right_m_s


def test_wheels_further_apart_than_the_window_make_no_twist() -> None:
    decoder = puma(window_s=0.02)
    early = [puma_frame(d, 1.0) for d in (2, 3, 4)]
    assert not feed(decoder, *early, puma_frame(5, 1.0, t_ns=21 * MS))
    assert decoder.counters.stale_values == 3
    assert feed(decoder, *(puma_frame(d, 1.0, t_ns=30 * MS) for d in (2, 3, 4)))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_no_number_is_missing(bad: float, own_dbc: str) -> None:
    decoder = TwistDecoder(vehicle_layout("custom", {"dbc": own_dbc, **OWN_LAYOUT}), 0.02)
    assert not feed(decoder, frame(256, struct.pack("<ff", 3.6, bad), extended=False))
    assert decoder.counters.invalid_values == 1
    (sample,) = feed(decoder, frame(256, struct.pack("<ff", 3.6, 7.2), extended=False))
    assert (sample.left_m_s, sample.right_m_s) == pytest.approx((1.0, 2.0))


def test_multiplexed_signals_make_one_twist(own_dbc: str) -> None:
    layout = {"dbc": own_dbc, "left": ["Paged.Left"], "right": ["Paged.Right"]}
    decoder = TwistDecoder(vehicle_layout("custom", layout), 0.02)
    pages = [frame(258, bytes([n]) + struct.pack("<h", 500), extended=False) for n in (0, 1)]
    assert [t.speed_m_s for t in feed(decoder, *pages)] == [0.5]
    assert decoder.counters.invalid_values == 0


def test_data_that_the_dbc_file_does_not_fit_are_counted() -> None:
    decoder = puma()
    assert not feed(decoder, frame(0x02021542, b"\x01\x02"))
    assert decoder.counters.undecodable == 1


@given(
    st.lists(
        st.builds(
            CanFrameSample,
            st.integers(0, 10**9),
            st.sampled_from([0x02021542, 0x02021543, 0x02021544, 0x02021545, 0x311]),
            st.booleans(),
            st.booleans(),
            st.booleans(),
            st.binary(max_size=8),
            st.just("x"),
            st.just(0),
        ),
        max_size=60,
    )
)
def test_any_frames_give_finite_twists_or_none(frames: list[CanFrameSample]) -> None:
    for number, sample in enumerate(feed(PUMA_FOR_FUZZ, *frames)):
        assert math.isfinite(sample.speed_m_s)
        assert math.isfinite(sample.yaw_rate_rad_s)
        assert sample.yaw_rate_sigma_rad_s > 0 < sample.speed_sigma_m_s
        assert sample.sequence >= number


PUMA_FOR_FUZZ = puma(window_s=1.0)


# --- layouts ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"left": ["PumaSpeed2.Rpm"]}, r"no signal 'PumaSpeed2.Rpm' in .*clearpath_puma.dbc"),
        ({"left": ["Engine.Speed"]}, "its messages are PumaPosition1, PumaPosition2"),
        ({"left": ["PumaPosition2.Position"]}, "unit 'rev' in the DBC file; expected m/s"),
        ({"dbc": "nowhere"}, "cannot read DBC file nowhere: .*No such file"),
    ],
)
def test_a_layout_that_the_dbc_file_does_not_fit_is_named(
    changes: Mapping[str, object], message: str
) -> None:
    with pytest.raises(DriverError, match=message):
        puma(changes=changes)


def test_a_file_that_is_no_dbc_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bad.dbc"
    path.write_text("hello {\nworld")
    with pytest.raises(DriverError, match=r"cannot read DBC file .*bad.dbc: .*Invalid syntax"):
        puma(changes={"dbc": str(path)})


@pytest.mark.parametrize(
    ("vehicle", "changes", "message"),
    [
        ("tank", {}, "no vehicle 'tank'; expected one of puma, scout_v2, custom"),
        ("custom", {}, "dbc: Field required"),
        ("puma", {"wheel_radius": 0.1}, "wheel_radius: Extra inputs are not permitted; fields are"),
        ("puma", {"wheel_radius_m": -0.1}, "wheel_radius_m: Input should be greater than 0"),
        ("puma", {"right": []}, "give either left and right, or speed and yaw_rate"),
        ("scout_v2", {"left": ["a.b"], "right": ["a.c"]}, "give either left and right"),
    ],
)
def test_a_layout_that_makes_no_sense_is_refused(
    vehicle: str, changes: Mapping[str, object], message: str
) -> None:
    with pytest.raises(DriverError, match=message):
        vehicle_layout(vehicle, changes)


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_every_shipped_layout_fits_its_dbc_file(vehicle: str) -> None:
    assert TwistDecoder(VEHICLES[vehicle], 0.02).missing
