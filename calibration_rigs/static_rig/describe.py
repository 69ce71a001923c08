"""An inertial calibration in words."""

from __future__ import annotations

from collections.abc import Sequence

from mapping.inertial_calibration import (
    AccelerometerCalibration,
    GyroCalibration,
    NoiseParts,
    Uncertain,
    VibrationPoint,
)


def describe_gyro(part: GyroCalibration | None) -> list[str]:
    """Return what is known of a gyro, a line each."""
    if part is None:
        return []
    lines = []
    if part.bias_rad_s:
        lines.append(f"gyro bias: {_text(part.bias_rad_s)} rad/s")
    if part.noise:
        lines.append(_describe_noise("gyro", "rad/s", part.noise))
    if part.bias_per_c and part.bias_at_c is not None:
        lines.append(
            f"gyro bias over temperature: {_text(part.bias_per_c)} rad/s for a degree Celsius, "
            f"around {part.bias_at_c:.1f}"
        )
    if part.scale:
        lines.append(f"gyro scale: {_text(part.scale)}")
    return lines


def describe_accelerometer(part: AccelerometerCalibration | None) -> list[str]:
    """Return what is known of an accelerometer, a line each."""
    if part is None:
        return []
    lines = []
    for i, axis in enumerate("xyz"):
        if part.scale and part.bias_m_s2:
            lines.append(
                f"accelerometer {axis}: scale {_text(part.scale[i])}, "
                f"bias {_text(part.bias_m_s2[i])} m/s^2"
            )
        if part.noise:
            lines.append(_describe_noise(f"accelerometer {axis}", "m/s^2", part.noise[i]))
    return lines


def _describe_noise(name: str, unit: str, noise: NoiseParts) -> str:
    return (
        f"{name} noise: N {_text(noise.white_per_sqrt_hz)} {unit}/sqrt(Hz), "
        f"B {_text(noise.bias_instability)} {unit}, "
        f"K {_text(noise.random_walk_sqrt_hz)} {unit} sqrt(Hz), from {noise.duration_s:.0f} s"
    )


def _text(item: Uncertain) -> str:
    if item.sigma is None:
        return f"{item.value:.6g} +- unknown"
    return f"{item.value:.6g} +- {item.sigma:.2g}"


def describe_vibration(points: Sequence[VibrationPoint]) -> list[str]:
    """Return the sensitivity at each frequency, a line each."""
    return [
        f"vibration at {p.frequency_hz:g} Hz: {p.ratio:.4f} of the reference"
        + (f" +- {p.half_width_95:.4f} (95 %)" if p.half_width_95 is not None else "")
        for p in points
    ]
