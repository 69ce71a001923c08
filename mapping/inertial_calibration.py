"""The versioned JSON file that holds what a static rig measured of the inertial sensors.

    {"schema": "terravibe/inertial", "version": 1, "device": {...}, "recordings": [...],
     "gyro": {"bias_rad_s": {"value": 0.0102, "sigma": 1e-05}, ...}, "accelerometer": {...}, ...}

Unknown keys are refused, and a file that does not say its schema and version. What was not
measured is absent.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mapping.calibration_file import DeviceIdentity, first_fault
from mapping.errors import MappingError
from mapping.files import read_whole

INERTIAL_SCHEMA: Final = "terravibe/inertial"
_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Sigma = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Uncertain(_Strict):
    """A value and its standard deviation in the same unit; None where nothing tells it."""

    value: _Finite
    sigma: _Sigma | None = None


class NoiseParts(_Strict):
    """Coefficients of the Allan variance; [x] = unit of the signal.

    Attributes:
        white_per_sqrt_hz: N, [x] / sqrt(Hz).
        bias_instability: B, [x].
        random_walk_sqrt_hz: K, [x] sqrt(Hz); too large from short recordings.
        duration_s: length of the recording that they come from.
    """

    white_per_sqrt_hz: Uncertain
    bias_instability: Uncertain
    random_walk_sqrt_hz: Uncertain
    duration_s: _Sigma


class GyroCalibration(_Strict):
    """A single-axis gyro; unit of the noise: rad/s.

    Attributes:
        bias_rad_s: mean rate at rest.
        noise: from the same rest.
        bias_per_c: change of the bias for a degree Celsius, rad/s, about `bias_at_c`.
        scale: true rate = scale x (rate - bias).
    """

    bias_rad_s: Uncertain | None = None
    noise: NoiseParts | None = None
    bias_per_c: Uncertain | None = None
    bias_at_c: _Finite | None = None
    scale: Uncertain | None = None


class AccelerometerCalibration(_Strict):
    """A triaxial accelerometer: force = T diag(1/scale) (reading - bias), readings in m/s^2.

    Attributes:
        scale: three factors, reading over force.
        bias_m_s2: three biases.
        crooked_rad: three angles, -T(0, 1), T(0, 2), -T(1, 2).
        noise: of each axis, m/s^2.
    """

    scale: tuple[Uncertain, Uncertain, Uncertain] | None = None
    bias_m_s2: tuple[Uncertain, Uncertain, Uncertain] | None = None
    crooked_rad: tuple[_Finite, _Finite, _Finite] | None = None
    noise: tuple[NoiseParts, NoiseParts, NoiseParts] | None = None


class VibrationPoint(_Strict):
    """Sensor over reference at one frequency; half of the 95 % interval, None for one reading."""

    frequency_hz: _Sigma
    ratio: _Sigma
    half_width_95: _Sigma | None = None
    repetitions: int


class SourceFile(_Strict):
    """A recording that the numbers come from."""

    name: str
    sha256: str


class InertialFile(_Strict):
    """The whole file."""

    schema_name: Literal["terravibe/inertial"] = Field(alias="schema")
    version: Literal[1]
    device: DeviceIdentity = DeviceIdentity()
    recordings: tuple[SourceFile, ...] = ()
    gyro: GyroCalibration | None = None
    accelerometer: AccelerometerCalibration | None = None
    vibration: tuple[VibrationPoint, ...] = ()

    def to_json(self) -> str:
        """Return the file's text; `read_inertial` gives the same values back."""
        return self.model_dump_json(indent=2, by_alias=True, exclude_none=True)


def read_inertial(path: Path) -> InertialFile:
    """Read a file that `terravibe calibrate static` wrote.

    Raises:
        MappingError: it cannot be read, or is not this schema and version.
    """
    return parse_inertial(read_whole(path), str(path))


def parse_inertial(text: str | bytes, where: str) -> InertialFile:
    """Return what the JSON `text` holds; `where` names it in errors.

    Raises:
        MappingError: it is not this schema and version.
    """
    # JSON has no tuples: strict mode would refuse its arrays, so validation goes by the text.
    try:
        return InertialFile.model_validate_json(text)
    except ValidationError as error:
        raise MappingError(
            f"{where}: {first_fault(error)}; expected an inertial calibration, version 1"
        ) from error
