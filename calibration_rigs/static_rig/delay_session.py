"""From a recording of a rover that was turned by hand to the delays of its yaw sensors."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.reader import StreamReader
from calibration_rigs.errors import RigError
from calibration_rigs.static_rig.delay import Delay, YawRate, relative_delay
from calibration_rigs.static_rig.gaps import Gap, describe_gaps, gaps_of
from drivers.samples import PoseSample, WheelTwistSample, YawRateSample

# In this order the first that a recording holds is the reference.
SENSORS = ("mocap", "gyro", "wheels")
# The block of rover.toml that is written, and its settings; motion capture has none.
TABLE = "map.ego_motion"
DELAY_KEYS = {"gyro": "gyro_delay_s", "wheels": "wheels_delay_s"}


@dataclass(frozen=True, slots=True)
class DelayCalibration:
    """Delays of the yaw sensors against one of them.

    Attributes:
        reference: whose stamps are taken to be `reference_delay_s` late.
        reference_delay_s: what the user knows of that.
        delays: of the others, against the reference, by name.
        source: name of the recording.
        gaps: of the sensors that have some, by name; seconds after the first yaw of any of them.
    """

    reference: str
    reference_delay_s: float
    delays: dict[str, Delay]
    source: str
    gaps: dict[str, tuple[Gap, ...]] = field(default_factory=dict)

    def toml(self) -> str:
        """Return the block for rover.toml."""
        lines = [
            f"# from {self.source}; +- is one sigma; the reference is {self.reference}, whose",
            f"# stamps are taken to be {1e3 * self.reference_delay_s:g} ms late",
            *(f"# {name} has {describe_gaps(gaps)}" for name, gaps in self.gaps.items()),
            f"[{TABLE}]",
        ]
        if self.reference in DELAY_KEYS and self.reference_delay_s >= 0.0:
            lines.append(f"{DELAY_KEYS[self.reference]} = {self.reference_delay_s:.6f}")
        for name, delay in self.delays.items():
            total_s = self._total_s(delay)
            if name in DELAY_KEYS and total_s >= 0.0:
                lines.append(f"{DELAY_KEYS[name]} = {total_s:.6f}  # +- {delay.sigma_s:.6f}")
            else:  # ego-motion takes no delay of this sensor, or none below 0
                lines.append(f"# {name}: {total_s:.6f} s +- {delay.sigma_s:.6f}")
        return "\n".join(lines) + "\n"

    def as_json(self) -> object:
        """Return all numbers by name."""
        return {
            "reference": self.reference,
            "reference_delay_s": self.reference_delay_s,
            "delays": {name: asdict(delay) for name, delay in self.delays.items()},
            "gaps": {name: [gap._asdict() for gap in gaps] for name, gaps in self.gaps.items()},
        }

    def describe(self) -> list[str]:
        """Return lines for people."""
        lines = [f"reference: {self.reference}, {1e3 * self.reference_delay_s:g} ms late"]
        for name, delay in self.delays.items():
            lines.append(
                f"{name}: {1e3 * self._total_s(delay):.3f} +- {1e3 * delay.sigma_s:.3f} ms late; "
                f"turns {delay.gain:+.3f} of the reference, correlation {delay.correlation:.4f}, "
                f"{delay.duration_s:.0f} s"
            )
            if self._total_s(delay) < 0.0:
                lines.append(
                    f"warning: {name} is earlier than the reference and gets no line in the file: "
                    "the reference is late itself; say by how much with --reference-delay-ms"
                )
            if delay.gain < 0.0:
                lines.append(f"warning: {name} turns against the reference; check its mount")
        for name, gaps in self.gaps.items():
            lines.append(f"warning: {name} has {describe_gaps(gaps)}; what lies around is not used")
        return lines

    def _total_s(self, delay: Delay) -> float:
        """Return how late a sensor is; 0 where that is as near as the two can be told apart."""
        total_s = self.reference_delay_s + delay.delay_s
        return 0.0 if -3.0 * delay.sigma_s < total_s < 0.0 else total_s


def calibrate_delays(
    path: Path, reference: str | None = None, reference_delay_s: float = 0.0
) -> DelayCalibration:
    """Return the delays of the yaw sensors of a recording.

    Args:
        path: the recording.
        reference: one of SENSORS; None = the first of them that the recording holds.
        reference_delay_s: by how much the reference's own stamps are late.

    Raises:
        RigError: fewer than two sensors saw yaw, or not the same motion.
        StreamError: the recording cannot be read.
    """
    rates = read_yaw_rates(path)
    chosen = reference or next((name for name in SENSORS if name in rates), "")
    if len(rates) < 2 or chosen not in rates:
        raise RigError(
            f"{path} holds yaw of {', '.join(rates) or 'no sensor'}; expected at least two of "
            f"{', '.join(SENSORS)}{f', {reference} among them' if reference else ''}"
        )
    delays = {}
    for name, rate in rates.items():
        if name == chosen:
            continue
        try:
            delays[name] = relative_delay(rates[chosen], rate)
        except RigError as error:
            raise RigError(f"{name} against {chosen}: {error}") from error
    gaps = {name: found for name, rate in rates.items() if (found := gaps_of(rate.t_s))}
    return DelayCalibration(chosen, reference_delay_s, delays, path.name, gaps)


def read_yaw_rates(path: Path) -> dict[str, YawRate]:
    """Return the yaw rates that a recording holds, by sensor, in the order of SENSORS.

    Raises:
        RigError: it is damaged.
        StreamError: it cannot be read.
    """
    rows: dict[str, list[tuple[int, float]]] = {name: [] for name in SENSORS}
    with FinishedFile(path) as source:
        reader = StreamReader(source)
        for message in reader:
            _sort_in(message.sample, rows)
        if reader.report.damaged:
            raise RigError(
                f"{path} is damaged in {len(reader.report.damaged)} places; a calibration needs "
                "it whole: run `terravibe recover`, and use what that gives"
            )
    starts = [row[0][0] for row in rows.values() if row]
    found = {name: _series(row, min(starts)) for name, row in rows.items() if len(row) > 3}
    if "mocap" in found:
        found["mocap"] = _differentiated(found["mocap"])
    return found


def _sort_in(sample: object, rows: dict[str, list[tuple[int, float]]]) -> None:
    if isinstance(sample, PoseSample):
        w, x, y, z = sample.quat_wxyz
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        rows["mocap"].append((sample.t_ns, yaw))
    elif isinstance(sample, YawRateSample):
        rows["gyro"].append((sample.t_ns, sample.rate_rad_s))
    elif isinstance(sample, WheelTwistSample):
        rows["wheels"].append((sample.t_ns, sample.yaw_rate_rad_s))


def _series(rows: list[tuple[int, float]], start_ns: int) -> YawRate:
    """Return times and values, each time once."""
    t_ns, first = np.unique([row[0] for row in rows], return_index=True)
    values = np.array([row[1] for row in rows], np.float64)[first]
    return YawRate(np.asarray((t_ns - start_ns) * 1e-9, np.float64), values)


def _differentiated(angle: YawRate) -> YawRate:
    """Return the rate half way between the angles, but for those with a gap between them."""
    t_s, turned = angle.t_s, np.unwrap(angle.rate_rad_s)
    known = ~np.isin(t_s[:-1], [gap.begin_s for gap in gaps_of(t_s)])
    middle_s, rate_rad_s = 0.5 * (t_s[1:] + t_s[:-1]), np.diff(turned) / np.diff(t_s)
    return YawRate(middle_s[known], rate_rad_s[known])
