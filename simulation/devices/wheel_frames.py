"""Wheel speeds as frames on a vehicle's CAN bus, and the twist that a driver makes of them.

The frames are those of the drivers' DBC files `clearpath_puma` and `agilex_scout_v2`, written
out here, so that a fault in either shows against the other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drivers.samples import CanFrameSample, Sample, WheelTwistSample
from simulation.devices.device_stream import DeviceClock, DeviceStream, increasing
from simulation.errors import SimulationError
from simulation.faults import Fault, arriving
from simulation.motion import Motion
from simulation.vehicle.jackal import EFFECTIVE_TRACK_M, WHEEL_RADIUS_M

Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]

# Puma: 16.16 fixed point, little-endian, turns per minute of the motor; front left, rear left,
# front right, rear right.
_PUMA_SPEED_ID = 0x02021540
_PUMA_DEVICES = (2, 3, 5, 4)
_PUMA_GEAR = 24.0
_PUMA_COUNTS_PER_RPM = 65536.0
_RAD_S_PER_RPM = 2.0 * math.pi / 60.0
# Speed of a rim per turn a minute of its motor, in the order in which a driver multiplies.
_PUMA_RIM_M_S_PER_RPM = _RAD_S_PER_RPM * (WHEEL_RADIUS_M / _PUMA_GEAR)
# Scout: int16 mm/s and mrad/s, int32 mm left and right, big-endian.
_SCOUT_IDS = (0x221, 0x311)
_FRAME_GAP_NS = 250_000  # frames of one set follow each other on the bus

# What a driver assumes of its vehicle unless it is told otherwise.
_RIM_SIGMA_M_S = 0.02
_TRACK_SIGMA_RATIO = 0.1


@dataclass(frozen=True, slots=True)
class WheelBus:
    """The vehicle's wheel encoders and its bus.

    Attributes:
        layout: "puma", a frame per motor; "scout_v2", the base's own twist and its odometer.
        clock: how often a set of frames is sent.
        counts_per_turn: of an encoder, per turn of the wheel; a speed is the difference of two
            counts over the period, so that it is 0 at rest. Assumed: 1024 a turn of the motor.
        channel: name of the bus.
    """

    layout: Literal["puma", "scout_v2"] = "puma"
    clock: DeviceClock = field(
        default_factory=lambda: DeviceClock(50.0, drift_ppm=20.0, latency_s=0.002, jitter_s=2e-4)
    )
    counts_per_turn: int = 24 * 1024
    channel: str = "can0"

    def __post_init__(self) -> None:
        if self.layout not in ("puma", "scout_v2"):
            raise SimulationError(f"a bus layout {self.layout!r}; expected puma or scout_v2")
        if self.counts_per_turn < 1:
            raise SimulationError(f"counts_per_turn is {self.counts_per_turn}; expected 1 or more")


@dataclass(frozen=True, slots=True)
class _FrameSets:
    """What is on the bus.

    Attributes:
        ids: identifiers of the frames of a set.
        data: of every set, the data of its frames.
        twist_frames: how many frames of a set a twist needs.
        twists: of every set: speed, yaw rate, left and right rim speed.
    """

    ids: tuple[int, ...]
    data: Sequence[Sequence[bytes]]
    twist_frames: int
    twists: Sequence[tuple[float, float, float | None, float | None]]


def wheel_streams(
    motion: Motion, bus: WheelBus, faults: Sequence[Fault], random: np.random.Generator
) -> tuple[DeviceStream, DeviceStream]:
    """Return the frames, and the twists, each with the stamp of the frame that completes it."""
    edges_ns = bus.clock.edges_ns(motion.start_ns, motion.duration_ns, random)
    sent_ns = edges_ns[1:]
    sets = _frame_sets(motion, bus, edges_ns)
    count = len(sets.ids)
    arrived = arriving(faults, "wheels", np.repeat(motion.elapsed_s(sent_ns), count), random)
    stamps = bus.clock.stamps_ns(sent_ns, random)[:, np.newaxis] + _FRAME_GAP_NS * np.arange(count)
    frames_ns = increasing(stamps.ravel())
    complete_ns = frames_ns.reshape(-1, count)[:, sets.twist_frames - 1]

    def frame(index: int, sequence: int) -> Sample:
        """Return that frame, counted over all sets."""
        which = index % count
        return CanFrameSample(
            int(frames_ns[index]),
            sets.ids[which],
            is_extended=sets.ids[which] > 0x7FF,
            is_remote=False,
            is_error=False,
            data=sets.data[index // count][which],
            channel=bus.channel,
            sequence=sequence,
        )

    def twist(index: int, sequence: int) -> Sample:
        """Return the twist of that set of frames; m/s and rad/s."""
        speed, yaw_rate, left, right = sets.twists[index]
        sigmas = _sigmas(yaw_rate)
        return WheelTwistSample(
            int(complete_ns[index]), speed, yaw_rate, *sigmas, left, right, sequence
        )

    whole = np.all(arrived.reshape(-1, count)[:, : sets.twist_frames], axis=1)
    return (
        DeviceStream("wheels", CanFrameSample, np.repeat(sent_ns, count), arrived, frame),
        DeviceStream("wheels", WheelTwistSample, sent_ns, np.atleast_1d(whole), twist),
    )


def _frame_sets(motion: Motion, bus: WheelBus, edges_ns: Int64Array) -> _FrameSets:
    """Return what the encoders' counts become."""
    radians_per_count = 2.0 * math.pi / bus.counts_per_turn
    counts = np.rint(motion.wheel_angles_at(edges_ns) / radians_per_count)
    angles = counts * radians_per_count
    # The controller divides by the period of its own clock.
    rates = np.diff(angles, axis=0) * bus.clock.rate_hz
    return _puma(rates) if bus.layout == "puma" else _scout(rates, angles[1:])


def _puma(rates_rad_s: Float64Array) -> _FrameSets:
    counts_per_rad_s = _PUMA_GEAR / _RAD_S_PER_RPM * _PUMA_COUNTS_PER_RPM
    values = np.rint(rates_rad_s * counts_per_rad_s).astype(np.int64)
    left, right = _sides(values / _PUMA_COUNTS_PER_RPM * _PUMA_RIM_M_S_PER_RPM)
    speed, yaw_rate = _twist(left, right)
    return _FrameSets(
        ids=tuple(_PUMA_SPEED_ID | device for device in _PUMA_DEVICES),
        data=[[_bytes(v, 4, "little") for v in row] for row in values.tolist()],
        twist_frames=len(_PUMA_DEVICES),
        twists=list(
            zip(speed.tolist(), yaw_rate.tolist(), left.tolist(), right.tolist(), strict=True)
        ),
    )


def _scout(rates_rad_s: Float64Array, angles_rad: Float64Array) -> _FrameSets:
    speed, yaw_rate = _twist(*_sides(rates_rad_s * WHEEL_RADIUS_M))
    milli = np.rint(1000.0 * np.column_stack([speed, yaw_rate])).astype(np.int64).tolist()
    run_mm = np.rint(1000.0 * WHEEL_RADIUS_M * np.column_stack(_sides(angles_rad))).astype(np.int64)
    return _FrameSets(
        ids=_SCOUT_IDS,
        data=[
            [
                _bytes(v, 2, "big") + _bytes(w, 2, "big") + bytes(4),
                _bytes(left, 4, "big") + _bytes(right, 4, "big"),
            ]
            for (v, w), (left, right) in zip(milli, run_mm.tolist(), strict=True)
        ],
        twist_frames=1,
        twists=[(1e-3 * v, 1e-3 * w, None, None) for v, w in milli],
    )


def _bytes(value: int, length: int, order: Literal["big", "little"]) -> bytes:
    return value.to_bytes(length, order, signed=True)


def _sides(per_wheel: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return the means of the left and of the right wheels."""
    return per_wheel[:, :2].mean(axis=1), per_wheel[:, 2:].mean(axis=1)


def _twist(left_m_s: Float64Array, right_m_s: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return speed and yaw rate by the base's own effective track."""
    return (left_m_s + right_m_s) / 2.0, (right_m_s - left_m_s) / EFFECTIVE_TRACK_M


def _sigmas(yaw_rate_rad_s: float) -> tuple[float, float]:
    """Return sigmas of speed and yaw rate: s / sqrt(2), and s sqrt(2) / B_e with k w on top."""
    from_rims = math.sqrt(2.0) * _RIM_SIGMA_M_S / EFFECTIVE_TRACK_M
    return _RIM_SIGMA_M_S / math.sqrt(2.0), math.hypot(
        from_rims, _TRACK_SIGMA_RATIO * yaw_rate_rad_s
    )
