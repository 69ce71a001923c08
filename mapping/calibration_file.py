"""The versioned JSON file that holds a device's depth noise model.

    {"schema": "terravibe/depth-noise", "version": 1,
     "device": {"model": "Kinect V1", "serial": "A00362901234"},
     "model": {"name": "...", "axial_offset_m": 0.0012, ...}}

The keys of "model" are the attributes of `mapping.noise.DepthNoiseModel`. Unknown keys are
refused; absent keys of "model" and "device" keep their defaults, but a file that does not say its
schema and version is refused: it may be of any. Validity is the range of the model.

Version 2 adds "measured": how the model came about, what it is worth, and the box of distances,
angles and conditions in which it holds.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Final, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from drivers.errors import reason_of
from mapping.errors import MappingError
from mapping.noise import PRESETS, DepthNoiseModel, constant_noise

# Far beyond any sensor; the kernels square these numbers in float32.
_LARGEST = 1e6
DEPTH_NOISE_SCHEMA: Final = "terravibe/depth-noise"
_NotNegative = Annotated[float, Field(ge=0.0, le=_LARGEST, allow_inf_nan=False)]
_Finite = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST, allow_inf_nan=False)]
_Positive = Annotated[float, Field(gt=0.0, le=_LARGEST, allow_inf_nan=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class DeviceIdentity(_Strict):
    """Which device a calibration was measured on; empty where nobody knows."""

    model: str = ""
    serial: str = ""

    def refuse_other(self, found: DeviceIdentity, where: str, remedy: str) -> None:
        """Refuse a recording of a device that is not this one.

        Args:
            found: the device of the recording.
            where: the calibration's file, for the message.
            remedy: what to do.

        Raises:
            MappingError: both serial numbers are known, and they differ.
        """
        if self.serial and found.serial and self.serial != found.serial:
            raise MappingError(
                f"{where} was measured on {self.model} {self.serial}, the recording is of "
                f"{found.model} {found.serial}; {remedy}"
            )


class NoiseCoefficients(_Strict):
    """The coefficients, as in `mapping.noise.DepthNoiseModel`."""

    name: str
    axial_offset_m: _NotNegative
    axial_quadratic_per_m: _NotNegative = 0.0
    axial_reference_m: _Finite = 0.0
    axial_angle_m_sqrt_m: _NotNegative = 0.0
    lateral_offset_px: _NotNegative = 0.0
    lateral_angle_px: _NotNegative = 0.0
    quantum_per_m: _NotNegative = 0.0
    bias_m: _Finite = 0.0
    bias_slope: _Finite = 0.0
    bias_quadratic_per_m: _Finite = 0.0
    bias_sigma_m: _NotNegative = 0.0
    bias_sigma_quadratic_per_m: _NotNegative = 0.0
    correlation_area_px: Annotated[float, Field(ge=1.0, allow_inf_nan=False)] = 1.0
    fixed_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.3
    range_min_m: _Positive = 0.4
    range_max_m: _Positive = 4.0


class ValidityBox(_Strict):
    """Where the model was measured; None = nobody measured that."""

    range_min_m: _Positive
    range_max_m: _Positive
    incidence_max_rad: _NotNegative
    lux_min: _NotNegative | None = None
    lux_max: _NotNegative | None = None
    temperature_min_c: _Finite | None = None
    temperature_max_c: _Finite | None = None


class Measured(_Strict):
    """How a model was measured.

    Attributes:
        validity: where it holds.
        environment: indoor or outdoor.
        law, parameters, covariance: the fitted law of sigma(z, theta) as the rig names it.
        held_out_share: how far it misses a station that it has not seen; 0.02 = 2 %.
        bias_covariance: of the bias coefficients b0, b1, b2.
        tape_zero_sigma_m: what all tape readings share.
        cells, frames: used.
        effective_readings: median over the cells of N_eff, the independent readings that would
            tell sigma as well.
        disparity_px_m, disparity_step_px: focal length times baseline, and the step.
        intrinsics_px: fx, fy, cx, cy. size_px: width, height.
        raw_sha256: of the recordings.
        software: what made the file.
    """

    validity: ValidityBox
    environment: str
    law: str
    parameters: tuple[_Finite, ...] = Field(strict=False)
    covariance: tuple[tuple[float, ...], ...] = Field(strict=False)
    held_out_share: _NotNegative
    bias_covariance: tuple[tuple[float, ...], ...] = Field(strict=False)
    tape_zero_sigma_m: _NotNegative
    cells: int
    frames: int
    effective_readings: _NotNegative
    disparity_px_m: _Positive
    disparity_step_px: _Positive
    intrinsics_px: tuple[float, float, float, float] = Field(strict=False)
    size_px: tuple[int, int] = Field(strict=False)
    raw_sha256: str
    software: str


class NoiseFile(_Strict):
    """The whole file."""

    schema_name: Literal["terravibe/depth-noise"] = Field(alias="schema")
    version: Literal[1, 2]
    device: DeviceIdentity = DeviceIdentity()
    model: NoiseCoefficients
    measured: Measured | None = None

    @model_validator(mode="after")
    def _has_its_version(self) -> Self:
        if (self.measured is not None) != (self.version == 2):
            raise ValueError('version 2 has "measured", version 1 has not')
        return self


@dataclass(frozen=True, slots=True)
class Calibration:
    """What a file holds.

    Attributes:
        model: its range is the one in which it holds.
        device: which one it was measured on; empty when the file does not say.
        measured: how; None for a file that was written by hand.
        where: the file's name, for messages.
    """

    model: DepthNoiseModel
    device: DeviceIdentity
    measured: Measured | None
    where: str

    def check_device(self, found: DeviceIdentity) -> None:
        """Refuse the depth camera of a recording that is not the one that was measured.

        Raises:
            MappingError: both serial numbers are known, and they differ.
        """
        remedy = "calibrate that device, or give --noise kinect-v1"
        self.device.refuse_other(found, self.where, remedy)


def parse_noise(text: str, where: str) -> DepthNoiseModel:
    """Return the model in the JSON `text`; see `parse_calibration`."""
    return parse_calibration(text, where).model


def parse_calibration(text: str, where: str) -> Calibration:
    """Return what the JSON `text` holds; `where` names it in errors.

    Raises:
        MappingError: not JSON, not this schema or version, or an impossible value.
    """
    try:
        found = NoiseFile.model_validate_json(text)
    except ValidationError as error:
        raise MappingError(
            f"{where}: {first_fault(error)}; expected a depth noise file, version 1 or 2"
        ) from error
    model = DepthNoiseModel(**found.model.model_dump())
    _require_usable(model, where)
    return Calibration(model, found.device, found.measured, where)


def noise_to_json(
    model: DepthNoiseModel,
    device: DeviceIdentity | None = None,
    measured: Measured | None = None,
) -> str:
    """Return the file's text for a model; `parse_noise` gives the same model back.

    Raises:
        MappingError: `parse_noise` would refuse the model.
    """
    try:
        file = NoiseFile(
            schema=DEPTH_NOISE_SCHEMA,
            version=1 if measured is None else 2,
            device=device or DeviceIdentity(),
            model=NoiseCoefficients(**asdict(model)),
            measured=measured,
        )
    except ValidationError as error:
        raise MappingError(f"noise model {model.name!r}: {first_fault(error)}") from error
    _require_usable(model, f"noise model {model.name!r}")
    absent = {"measured"} if measured is None else set()
    return file.model_dump_json(indent=2, by_alias=True, exclude=absent)


def first_fault(error: ValidationError) -> str:
    """Return what pydantic found first in a calibration file, as `place: what`."""
    first = error.errors(include_url=False)[0]
    place = ".".join(str(part) for part in first["loc"]) or "the file"
    return f"{place}: {first['msg']}"


def noise_from_name(text: str) -> DepthNoiseModel:
    """Return the model that a user names; see `calibration_from_name`."""
    return calibration_from_name(text).model


def calibration_from_name(text: str) -> Calibration:
    """Return what a user names: a preset, `constant:SIGMA_M`, or a JSON file.

    Raises:
        MappingError: nothing of that kind is known.
    """
    if text in PRESETS:
        return Calibration(PRESETS[text], DeviceIdentity(), None, text)
    if text.startswith("constant:"):
        try:
            sigma_m = float(text.removeprefix("constant:"))
            return Calibration(constant_noise(sigma_m), DeviceIdentity(), None, text)
        except ValueError as error:
            raise MappingError(f"{text!r}: expected constant:SIGMA in metres") from error
    try:
        content = Path(text).read_text(encoding="utf-8")
    except (OSError, ValueError) as error:  # a NUL in the name is a ValueError
        known = ", ".join(PRESETS)
        raise MappingError(
            f"noise model {text!r} is none of {known}, constant:SIGMA_M, and cannot be read as a "
            f"calibration file ({reason_of(error)})"
        ) from error
    return parse_calibration(content, text)


def _require_usable(model: DepthNoiseModel, where: str) -> None:
    """Refuse a model that calls some reading perfect, or has no range."""
    if not model.range_min_m < model.range_max_m:
        raise MappingError(
            f"{where}: range_min_m is {model.range_min_m}, range_max_m is {model.range_max_m}; "
            "expected the first below the second"
        )
    best_m = min(max(model.axial_reference_m, model.range_min_m), model.range_max_m)
    if model.axial_sigma_m(np.array(best_m), np.array(0.0)) <= 0.0:
        raise MappingError(
            f"{where}: the model calls readings at {best_m} m perfect; expected axial_offset_m or "
            "quantum_per_m above 0, or axial_reference_m outside the range"
        )
