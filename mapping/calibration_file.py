"""The versioned JSON file that holds a device's depth noise model.

    {"schema": "terravibe/depth-noise", "version": 1,
     "device": {"model": "Kinect V1", "serial": "A00362901234"},
     "model": {"name": "...", "axial_offset_m": 0.0012, ...}}

The keys of "model" are the attributes of `mapping.noise.DepthNoiseModel`. Unknown keys are
refused; absent keys of "model" and "device" keep their defaults, but a file that does not say its
schema and version is refused: it may be of any. Validity is the range of the model.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mapping.errors import MappingError
from mapping.noise import PRESETS, DepthNoiseModel, constant_noise

# Far beyond any sensor; the kernels square these numbers in float32.
_LARGEST = 1e6
_NotNegative = Annotated[float, Field(ge=0.0, le=_LARGEST, allow_inf_nan=False)]
_Finite = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST, allow_inf_nan=False)]
_Positive = Annotated[float, Field(gt=0.0, le=_LARGEST, allow_inf_nan=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class DeviceIdentity(_Strict):
    """Which device the model was measured on."""

    model: str = ""
    serial: str = ""


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
    range_min_m: _Positive = 0.4
    range_max_m: _Positive = 4.0


class NoiseFile(_Strict):
    """The whole file."""

    schema_name: Literal["terravibe/depth-noise"] = Field(alias="schema")
    version: Literal[1]
    device: DeviceIdentity = DeviceIdentity()
    model: NoiseCoefficients


def parse_noise(text: str, where: str) -> DepthNoiseModel:
    """Return the model in the JSON `text`; `where` names it in errors.

    Raises:
        MappingError: not JSON, not this schema or version, or an impossible value.
    """
    try:
        found = NoiseFile.model_validate_json(text)
    except ValidationError as error:
        raise MappingError(
            f"{where}: {_first_fault(error)}; expected a depth noise file, version 1"
        ) from error
    model = DepthNoiseModel(**found.model.model_dump())
    _require_usable(model, where)
    return model


def noise_to_json(model: DepthNoiseModel, device: DeviceIdentity | None = None) -> str:
    """Return the file's text for a model; `parse_noise` gives the same model back.

    Raises:
        MappingError: `parse_noise` would refuse the model.
    """
    try:
        file = NoiseFile(
            schema="terravibe/depth-noise",
            version=1,
            device=device or DeviceIdentity(),
            model=NoiseCoefficients(**asdict(model)),
        )
    except ValidationError as error:
        raise MappingError(f"noise model {model.name!r}: {_first_fault(error)}") from error
    _require_usable(model, f"noise model {model.name!r}")
    return file.model_dump_json(indent=2, by_alias=True)


def _first_fault(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    place = ".".join(str(part) for part in first["loc"]) or "the file"
    return f"{place}: {first['msg']}"


def noise_from_name(text: str) -> DepthNoiseModel:
    """Return the model that a user names: a preset, `constant:SIGMA_M`, or a JSON file.

    Raises:
        MappingError: nothing of that kind is known.
    """
    if text in PRESETS:
        return PRESETS[text]
    if text.startswith("constant:"):
        try:
            return constant_noise(float(text.removeprefix("constant:")))
        except ValueError as error:
            raise MappingError(f"{text!r}: expected constant:SIGMA in metres") from error
    try:
        content = Path(text).read_text(encoding="utf-8")
    except (OSError, ValueError) as error:  # a NUL in the name is a ValueError
        known = ", ".join(PRESETS)
        raise MappingError(
            f"noise model {text!r} is none of {known}, constant:SIGMA_M, and cannot be read as a "
            f"calibration file ({error})"
        ) from error
    return parse_noise(content, text)


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
