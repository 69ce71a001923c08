"""What may go wrong on request. Times are seconds since the start of the run, rest included."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from simulation.errors import SimulationError

Device = Literal["vibration", "gyro", "wheels", "mocap", "depth"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Span:
    """When a fault is there.

    Attributes:
        start_s: beginning.
        duration_s: length; infinite until the end of the run.
    """

    start_s: float
    duration_s: float = math.inf

    def __post_init__(self) -> None:
        if not (0.0 <= self.start_s < math.inf and self.duration_s > 0.0):
            raise SimulationError(
                f"{type(self).__name__}: start_s {self.start_s}, duration_s {self.duration_s}; "
                "expected a start of 0 or more and a duration above 0"
            )

    def holds(self, t_s: float) -> bool:
        """Tell whether the fault is there at that time."""
        return self.start_s <= t_s < self.start_s + self.duration_s


@dataclass(frozen=True, slots=True, kw_only=True)
class _OfDevice(Span):
    device: Device

    def __post_init__(self) -> None:
        super(_OfDevice, self).__post_init__()
        if self.device not in get_args(Device):
            raise SimulationError(
                f"{type(self).__name__}: no device {self.device!r}; "
                f"expected one of {', '.join(get_args(Device))}"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Dropout(_OfDevice):
    """A device loses samples.

    Attributes:
        share: probability that a sample is lost; 1 loses all.
    """

    share: float = 1.0

    def __post_init__(self) -> None:
        super(Dropout, self).__post_init__()
        _check("Dropout: share", self.share, 0.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Unplug(_OfDevice):
    """A device is pulled out, and put back after the duration."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Slip(Span):
    """Wheels stand on slippery ground.

    Attributes:
        grip: factor on the shear strength of the ground.
        wheels: 0 front left, 1 rear left, 2 front right, 3 rear right.
    """

    grip: float = 0.2
    wheels: tuple[int, ...] = (0, 1, 2, 3)

    def __post_init__(self) -> None:
        super(Slip, self).__post_init__()
        _check("Slip: grip", self.grip, 0.0, 1.0)
        if not self.wheels or not set(self.wheels) <= {0, 1, 2, 3}:
            raise SimulationError(f"Slip: wheels {self.wheels}; expected some of 0, 1, 2, 3")


@dataclass(frozen=True, slots=True, kw_only=True)
class SpinningWheels(Span):
    """The vehicle hangs on its underside while all wheels turn in place.

    Attributes:
        speed_m_s: of the rims; replaces the commanded speed.
    """

    speed_m_s: float = 0.3

    def __post_init__(self) -> None:
        super(SpinningWheels, self).__post_init__()
        _check("SpinningWheels: speed_m_s", self.speed_m_s, -2.0, 2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class AccelerometerBias(Span):
    """The vibration sensor's accelerometer is off by a constant.

    Attributes:
        bias_m_s2: along the sensor's axes, on top of the bias that it has anyway.
    """

    bias_m_s2: tuple[float, float, float]

    def __post_init__(self) -> None:
        super(AccelerometerBias, self).__post_init__()
        if len(self.bias_m_s2) != 3 or not all(map(math.isfinite, self.bias_m_s2)):
            raise SimulationError(
                f"AccelerometerBias: bias_m_s2 {self.bias_m_s2}; expected three finite numbers"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Shock(Span):
    """A knock on the chassis: a force that rises and falls as half a sine.

    Attributes:
        velocity_change_m_s: impulse over the vehicle's mass, world axes.
    """

    duration_s: float = 0.01
    velocity_change_m_s: tuple[float, float, float] = (0.0, 0.0, 0.2)

    def __post_init__(self) -> None:
        super(Shock, self).__post_init__()
        if not 0.001 <= self.duration_s <= 1.0:
            raise SimulationError(f"Shock: duration_s {self.duration_s}; expected 0.001 to 1 s")
        for change in self.velocity_change_m_s:
            _check("Shock: velocity_change_m_s", change, -2.0, 2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class BlindPatches(Span):
    """Square patches of the depth image give no readings: dust on its way, or glare on the lens.

    Attributes:
        patches: how many.
        size: edge of a patch over the height of the image.
        moving: elsewhere in every frame, as dust is; otherwise always at the same places.
    """

    patches: int = 5
    size: float = 0.2
    moving: bool = True

    def __post_init__(self) -> None:
        super(BlindPatches, self).__post_init__()
        _check("BlindPatches: patches", self.patches, 1, 1000)
        _check("BlindPatches: size", self.size, 0.01, 1.0)


Fault = Dropout | Unplug | Slip | SpinningWheels | AccelerometerBias | Shock | BlindPatches


def _check(setting: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise SimulationError(f"{setting} is {value}; expected {low:g} to {high:g}")


def arriving(
    faults: Sequence[Fault],
    device: Device,
    elapsed_s: NDArray[np.float64],
    random: np.random.Generator,
) -> NDArray[np.bool_]:
    """Return which of a device's samples, measured at these (N,) times, get through."""
    kept = np.ones(elapsed_s.shape, np.bool_)
    for fault in faults:
        if isinstance(fault, Dropout | Unplug) and fault.device == device:
            share = fault.share if isinstance(fault, Dropout) else 1.0
            inside = (elapsed_s >= fault.start_s) & (elapsed_s < fault.start_s + fault.duration_s)
            kept &= ~(inside & (random.random(elapsed_s.shape) < share))
    return kept
