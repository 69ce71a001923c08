"""What a vehicle's CAN frames mean: which signals, of which wheels, on which geometry."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Self

from pydantic import BaseModel, ConfigDict, PositiveFloat, ValidationError, model_validator

from drivers.errors import DriverError

_DBC_FOLDER = Path(__file__).parent / "dbc"

LINEAR_UNITS_M_S: Mapping[str, float] = {"m/s": 1.0, "mm/s": 1e-3, "km/h": 1.0 / 3.6}
ANGULAR_UNITS_RAD_S: Mapping[str, float] = {
    "rad/s": 1.0,
    "mrad/s": 1e-3,
    "deg/s": math.radians(1.0),
    "rpm": 2.0 * math.pi / 60.0,
}


class VehicleLayout(BaseModel):
    """Signals and geometry of one vehicle.

    Signals are written `Message.Signal` as in the DBC file, with a leading `-` when the wheel
    turns backwards while the vehicle drives forwards. Their units are those in the DBC file: rim
    speeds as they are, shaft speeds times wheel radius over gear ratio. Either `left` and
    `right` are given, or `speed` and `yaw_rate` of a vehicle that does the kinematics itself.

    Attributes:
        dbc: a shipped file without its ending, or the path of another one.
        left: speeds of the left wheels; their mean counts.
        right: speeds of the right wheels.
        speed: forward speed of the vehicle.
        yaw_rate: yaw rate of the vehicle, counter-clockwise.
        wheel_radius_m: of a loaded wheel.
        gear_ratio: turns of the shaft that the signal tells of, per turn of the wheel.
        track_m: geometric distance of the left and right wheels' centres.
        effective_track_ratio: effective over geometric track, see `skid_steer`.
        yaw_rate_scale: correction of a vehicle's own yaw rate; 1 leaves it as it is.
        wheel_speed_sigma_m_s: standard deviation of one side's rim speed.
        track_sigma_ratio: relative standard deviation of the effective track.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    dbc: str
    left: tuple[str, ...] = ()
    right: tuple[str, ...] = ()
    speed: str = ""
    yaw_rate: str = ""
    wheel_radius_m: PositiveFloat = 0.098
    gear_ratio: PositiveFloat = 1.0
    track_m: PositiveFloat = 0.37559
    effective_track_ratio: PositiveFloat = 1.5
    yaw_rate_scale: float = 1.0
    wheel_speed_sigma_m_s: PositiveFloat = 0.02
    track_sigma_ratio: PositiveFloat = 0.1

    @model_validator(mode="after")
    def _one_way_to_the_twist(self) -> Self:
        sides, whole = bool(self.left), bool(self.speed)
        if (sides, whole) != (bool(self.right), bool(self.yaw_rate)) or sides == whole:
            raise ValueError("give either left and right, or speed and yaw_rate")
        return self

    @property
    def effective_track_m(self) -> float:
        """B_e of `skid_steer`, m: the track with which the differential-drive equations hold."""
        return self.track_m * self.effective_track_ratio

    @property
    def dbc_path(self) -> Path:
        """The DBC file."""
        shipped = _DBC_FOLDER / f"{self.dbc}.dbc"
        return shipped if shipped.is_file() else Path(self.dbc)


# Puma: four motor controllers numbered as in Clearpath's 4-wheel configuration, gear 24, on the
# wheels and track of a Jackal. Scout: 0.583 m is AgileX's track; the chassis turns its own
# wheel speeds into a yaw rate, by a track that it does not tell.
VEHICLES: Mapping[str, VehicleLayout] = {
    "puma": VehicleLayout(
        dbc="clearpath_puma",
        left=("PumaSpeed2.Speed", "PumaSpeed3.Speed"),
        right=("PumaSpeed5.Speed", "PumaSpeed4.Speed"),
        gear_ratio=24.0,
    ),
    "scout_v2": VehicleLayout(
        dbc="agilex_scout_v2",
        speed="MotionState.LinearSpeed",
        yaw_rate="MotionState.YawRate",
        track_m=0.583,
    ),
}


def vehicle_layout(vehicle: str, changes: Mapping[str, object]) -> VehicleLayout:
    """Return a known vehicle's layout with changes, or with vehicle "custom" the changes alone.

    Raises:
        DriverError: no such vehicle, an unknown field, or a value that makes no sense.
    """
    if vehicle != "custom" and vehicle not in VEHICLES:
        known = ", ".join([*VEHICLES, "custom"])
        raise DriverError(f"no vehicle {vehicle!r}; expected one of {known}")
    base = VEHICLES[vehicle].model_dump() if vehicle in VEHICLES else {}
    try:
        return VehicleLayout.model_validate({**base, **changes})
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "layout"
        raise DriverError(
            f"vehicle {vehicle!r}: {field}: {first['msg']}; fields are "
            f"{', '.join(VehicleLayout.model_fields)}"
        ) from error
