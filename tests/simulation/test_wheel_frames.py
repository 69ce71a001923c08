import math
from typing import Literal

import numpy as np
import pytest

from drivers.samples import CanFrameSample, WheelTwistSample
from drivers.wheels.twist_decoder import TwistDecoder
from drivers.wheels.vehicle_layout import VEHICLES
from simulation.devices.wheel_frames import WheelBus, wheel_streams
from simulation.errors import SimulationError
from simulation.faults import Dropout
from simulation.vehicle.jackal import EFFECTIVE_TRACK_M, WHEEL_RADIUS_M
from tests.simulation.motions import motion

RATES = (2.0, 2.2, 3.9, 4.1)
SPEED = 3.05 * WHEEL_RADIUS_M
YAW_RATE = 1.9 * WHEEL_RADIUS_M / EFFECTIVE_TRACK_M


@pytest.mark.parametrize("layout", ["puma", "scout_v2"])
def test_the_driver_decodes_the_frames_to_the_same_twists(
    layout: Literal["puma", "scout_v2"],
) -> None:
    turning = motion(2.0, wheel_rate_rad_s=RATES)
    streams = wheel_streams(turning, WheelBus(layout), (), np.random.default_rng(1))
    decoder = TwistDecoder(VEHICLES[layout], 0.05)
    frames = [frame for frame in streams[0] if isinstance(frame, CanFrameSample)]
    decoded = [twist for frame in frames if (twist := decoder.add(frame)) is not None]
    twists = [twist for twist in streams[1] if isinstance(twist, WheelTwistSample)]
    assert len(decoded) == len(twists) == pytest.approx(100, abs=1)
    for ours, theirs in zip(twists, decoded, strict=True):
        assert ours.t_ns == theirs.t_ns
        assert ours.sequence == theirs.sequence
        assert ours.speed_m_s == pytest.approx(theirs.speed_m_s, abs=1e-12)
        assert ours.yaw_rate_rad_s == pytest.approx(theirs.yaw_rate_rad_s, abs=1e-12)
        assert ours.speed_sigma_m_s == pytest.approx(theirs.speed_sigma_m_s)
        if layout == "puma":
            assert ours.left_m_s == pytest.approx(theirs.left_m_s, abs=1e-12)
            assert ours.yaw_rate_sigma_rad_s == pytest.approx(theirs.yaw_rate_sigma_rad_s)
        else:
            assert ours.left_m_s is None
        assert ours.speed_m_s == pytest.approx(SPEED, abs=0.002)
        assert ours.yaw_rate_rad_s == pytest.approx(YAW_RATE, abs=0.005)


def test_the_odometer_counts_millimetres() -> None:
    turning = motion(2.0, wheel_rate_rad_s=(-1.0, -1.0, 1.0, 1.0))
    frames, _ = wheel_streams(turning, WheelBus("scout_v2"), (), np.random.default_rng(1))
    last = [f for f in frames if isinstance(f, CanFrameSample) and f.arbitration_id == 0x311][-1]
    left, right = (int.from_bytes(last.data[i : i + 4], "big", signed=True) for i in (0, 4))
    assert -left == right == pytest.approx(2.0 * WHEEL_RADIUS_M * 1000.0, abs=3)


def test_wheels_at_rest_report_zero() -> None:
    _, twists = wheel_streams(motion(1.0), WheelBus(), (), np.random.default_rng(1))
    assert {t.speed_m_s for t in twists if isinstance(t, WheelTwistSample)} == {0.0}


def test_speeds_come_in_encoder_counts() -> None:
    rolling = motion(2.0, wheel_rate_rad_s=[0.01] * 4)
    bus = WheelBus(counts_per_turn=1000)
    _, twists = wheel_streams(rolling, bus, (), np.random.default_rng(1))
    speeds = {round(t.speed_m_s, 6) for t in twists if isinstance(t, WheelTwistSample)}
    assert speeds == {0.0, round(2 * math.pi / 1000 * 50.0 * WHEEL_RADIUS_M, 6)}


def test_a_lost_frame_costs_its_twist() -> None:
    fault = Dropout(device="wheels", start_s=0.0, share=0.2)
    rolling = motion(4.0, wheel_rate_rad_s=[1.0] * 4)
    frames, twists = wheel_streams(rolling, WheelBus(), (fault,), np.random.default_rng(1))
    assert len(frames) == pytest.approx(800 * 0.8, rel=0.1)
    assert len(twists) == pytest.approx(200 * 0.8**4, rel=0.3)
    assert [s.sequence for s in frames] == list(range(len(frames)))


@pytest.mark.parametrize(
    ("bus", "message"), [({"layout": "husky"}, "layout"), ({"counts_per_turn": 0}, "counts")]
)
def test_impossible_buses(bus: dict[str, object], message: str) -> None:
    with pytest.raises(SimulationError, match=message):
        WheelBus(**bus)  # type: ignore[arg-type] # that is the point
