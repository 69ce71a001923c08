"""From recordings of a rig to a calibration of the inertial sensors: what each recording tells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from calibration_rigs.errors import RigError
from calibration_rigs.static_rig import accelerometer, gyro, vibration
from calibration_rigs.static_rig.allan import AllanCurve, Coefficient, allan_curve, fit_allan
from calibration_rigs.static_rig.describe import (
    describe_accelerometer,
    describe_gyro,
    describe_vibration,
)
from calibration_rigs.static_rig.deviations import AtRest
from calibration_rigs.static_rig.rest import quiet_spread, rest_stretches
from calibration_rigs.static_rig.signals import Signal, Signals
from mapping.inertial_calibration import (
    AccelerometerCalibration,
    GyroCalibration,
    InertialFile,
    NoiseParts,
    Uncertain,
    VibrationPoint,
)

_Part = TypeVar("_Part", GyroCalibration, AccelerometerCalibration)

_QUIET_TIMES = 4.0
_MOVING_SHARE = 0.01
_FEWEST_SAMPLES = 1000
# Below this the bias instability of ordinary sensors is still hidden under their white noise.
_LONG_ENOUGH_S = 7200.0


@dataclass(slots=True)
class StaticCalibration:
    """What was measured, the curves behind it, and what the user should know about it.

    Attributes:
        file: the calibration.
        curves: Allan deviations by name of the signal.
        at_rest: the signals that they are of.
        warnings: sentences.
    """

    file: InertialFile
    curves: dict[str, AllanCurve] = field(default_factory=dict)
    at_rest: dict[str, AtRest] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)

    def as_json(self) -> object:
        """Return the calibration and the warnings."""
        content = self.file.model_dump(mode="json", by_alias=True, exclude_none=True)
        return content | {"warnings": self.warnings}

    def describe(self) -> list[str]:
        """Return lines for people."""
        lines = [
            *describe_gyro(self.file.gyro),
            *describe_accelerometer(self.file.accelerometer),
            *describe_vibration(self.file.vibration),
        ]
        return [*lines, *(f"warning: {warning}" for warning in self.warnings)]


def calibrate_rest(signals: Signals) -> StaticCalibration:
    """Return noise and bias of every sensor in a recording in which nothing moved.

    Raises:
        RigError: something moved, or the recording is too short to say anything.
    """
    result = StaticCalibration(_empty(signals))
    rates, forces = signals.gyro, signals.acceleration
    gyro_part = _rest_of_gyro(rates, result) if rates is not None else None
    force_part = _rest_of_accelerometer(forces, result) if forces is not None else None
    found = result.file.model_copy(update={"gyro": gyro_part, "accelerometer": force_part})
    result.file = found
    return result


def calibrate_attitudes(signals: Signals, gravity_m_s2: float) -> StaticCalibration:
    """Return scale and bias of the accelerometer from a recording of rests in several attitudes.

    Raises:
        RigError: no acceleration, too few attitudes, or all to one side.
    """
    signal = _need(signals.acceleration, "/acceleration")
    threshold = _QUIET_TIMES * quiet_spread(signal.t_s, signal.values)
    rests = rest_stretches(signal.t_s, signal.values, threshold=threshold)
    poses = accelerometer.mean_readings(signal.values, rests).reshape(-1, 3)
    found = accelerometer.calibrate_accelerometer(poses, gravity_m_s2)
    part = AccelerometerCalibration(
        scale=_three(found.scale, found.scale_sigma),
        bias_m_s2=_three(found.bias, found.bias_sigma),
        crooked_rad=(*map(float, found.crooked_rad),),  # type: ignore[arg-type] # three of them
    )
    return StaticCalibration(_empty(signals).model_copy(update={"accelerometer": part}))


def calibrate_turns(signals: Signals, true_rad: Sequence[float]) -> StaticCalibration:
    """Return the scale of the gyro from a recording of turns by known angles with rests between.

    Raises:
        RigError: no gyro, or other turns than the angles given.
    """
    signal = _need(signals.gyro, "/gyro")
    threshold = _QUIET_TIMES * quiet_spread(signal.t_s, signal.values)
    rests = rest_stretches(signal.t_s, signal.values, threshold=threshold)
    turns = gyro.turns_between(signal.t_s, signal.values[:, 0], rests)
    found = gyro.gyro_scale(turns, true_rad)
    part = GyroCalibration(scale=_uncertain(found.scale))
    return StaticCalibration(_empty(signals).model_copy(update={"gyro": part}))


def calibrate_shaker(path: Path) -> StaticCalibration:
    """Return the sensitivity of a vibration sensor from a table of comparisons.

    Raises:
        RigError: the table is faulty.
    """
    points = tuple(
        VibrationPoint(
            frequency_hz=item.frequency_hz,
            ratio=item.ratio,
            half_width_95=item.half_width_95 if math.isfinite(item.half_width_95) else None,
            repetitions=item.repetitions,
        )
        for item in vibration.sensitivities(vibration.read_comparisons(path))
    )
    return StaticCalibration(InertialFile(schema="terravibe/inertial", version=1, vibration=points))


def join(parts: Sequence[StaticCalibration]) -> StaticCalibration:
    """Return several calibrations as one; what two of them measured, the later one decides."""
    file = InertialFile(schema="terravibe/inertial", version=1)
    for part in parts:
        file = file.model_copy(
            update={
                "recordings": file.recordings + part.file.recordings,
                "gyro": _later(file.gyro, part.file.gyro),
                "accelerometer": _later(file.accelerometer, part.file.accelerometer),
                "vibration": part.file.vibration or file.vibration,
            }
        )
    curves = {name: curve for part in parts for name, curve in part.curves.items()}
    at_rest = {name: signal for part in parts for name, signal in part.at_rest.items()}
    warnings = [text for part in parts for text in part.warnings]
    return StaticCalibration(file, curves, at_rest, warnings)


def _later(first: _Part | None, second: _Part | None) -> _Part | None:
    if first is None or second is None:
        return second or first
    return first.model_copy(update={name: value for name, value in second if value is not None})


def _empty(signals: Signals) -> InertialFile:
    return InertialFile(schema="terravibe/inertial", version=1, recordings=(signals.source,))


def _need(signal: Signal | None, topic: str) -> Signal:
    if signal is None:
        raise RigError(f"the recording holds no {topic}; expected it for this calibration")
    return signal


def _rest_of_gyro(signal: Signal, result: StaticCalibration) -> GyroCalibration:
    whole = _unbroken(signal, "gyro", result)
    noise = _noise("gyro", whole.values[:, 0], whole, result)
    slope = _slope(whole)
    bias = float(whole.values.mean())
    walk = (noise.white_per_sqrt_hz.value / math.sqrt(noise.duration_s)) ** 2
    sigma = math.sqrt(walk + noise.bias_instability.value**2)
    return GyroCalibration(
        bias_rad_s=Uncertain(value=bias, sigma=sigma),
        noise=noise,
        bias_per_c=_uncertain(slope.per_c) if slope else None,
        bias_at_c=slope.middle_c if slope else None,
    )


def _rest_of_accelerometer(signal: Signal, result: StaticCalibration) -> AccelerometerCalibration:
    whole = _unbroken(signal, "accelerometer", result)
    x, y, z = (
        _noise(f"accelerometer {axis}", whole.values[:, i], whole, result)
        for i, axis in enumerate("xyz")
    )
    return AccelerometerCalibration(noise=(x, y, z))


def _unbroken(signal: Signal, name: str, result: StaticCalibration) -> Signal:
    """Return the part without gaps; refuse one that is too short."""
    whole = signal.longest_without_gap()
    _require_rest(whole, name)
    if len(whole.t_s) < _FEWEST_SAMPLES:
        raise RigError(
            f"{name}: {len(whole.t_s)} samples without a gap; expected {_FEWEST_SAMPLES} or more, "
            "and two to three hours for the slow parts of the noise"
        )
    duration_s = float(whole.t_s[-1] - whole.t_s[0])
    if len(whole.t_s) < len(signal.t_s):
        result.warnings.append(
            f"{name}: gaps; the longest stretch without, {duration_s:.0f} s, was used"
        )
    if duration_s < _LONG_ENOUGH_S:
        result.warnings.append(
            f"{name}: {duration_s:.0f} s at rest; bias instability and random walk want two to "
            "three hours and are too large from less"
        )
    return whole


def _require_rest(signal: Signal, name: str) -> None:
    threshold = _QUIET_TIMES * quiet_spread(signal.t_s, signal.values)
    rests = rest_stretches(signal.t_s, signal.values, threshold=threshold)
    moving = 1.0 - sum(rest.end - rest.first for rest in rests) / len(signal.t_s)
    # Each rest is found half a window short at either end.
    edges = signal.rate_hz / len(signal.t_s)
    if moving > _MOVING_SHARE + edges:
        raise RigError(
            f"{name}: not at rest for {100.0 * moving:.0f} % of the recording; expected a sensor "
            "that nothing touches, on solid ground"
        )


def _noise(
    name: str, values: gyro.Float64Array, whole: Signal, result: StaticCalibration
) -> NoiseParts:
    curve = allan_curve(values, whole.rate_hz)
    fit = fit_allan(curve)
    result.curves[name] = curve
    result.at_rest[name] = AtRest(values, whole.rate_hz)
    if not fit.random_walk.is_significant:
        result.warnings.append(f"{name}: the random walk does not stand out of the noise")
    return NoiseParts(
        white_per_sqrt_hz=_uncertain(fit.white),
        bias_instability=_uncertain(fit.instability),
        random_walk_sqrt_hz=_uncertain(fit.random_walk),
        duration_s=curve.duration_s,
    )


def _slope(signal: Signal) -> gyro.TemperatureSlope | None:
    """Return the bias over temperature where the chip tells its temperature and it moved."""
    if not np.isfinite(signal.temperature_c).all():
        return None
    try:
        return gyro.temperature_slope(signal.t_s, signal.values[:, 0], signal.temperature_c)
    except RigError:
        return None


def _uncertain(coefficient: Coefficient) -> Uncertain:
    return Uncertain(value=coefficient.value, sigma=coefficient.sigma)


def _three(
    values: gyro.Float64Array, sigmas: gyro.Float64Array
) -> tuple[Uncertain, Uncertain, Uncertain]:
    known = np.isfinite(sigmas)
    x, y, z = (
        Uncertain(value=float(v), sigma=float(s) if k else None)
        for v, s, k in zip(values, sigmas, known, strict=True)
    )
    return x, y, z
