"""How the errors of the poses reach the map, for each kind of pose source.

V = V_independent + V_systematic + V_relief                       the map's own, whatever the poses
  + (frame_sigma_m^2 + (frame_sigma_rad r)^2) (1 + drift_per_m D)   V_frame and V_drift
  + (gravity_sigma_rad r)^2                                         V_gravity
  + g' (Sigma_xy - Sigma_0) g                                       V_horizontal

r = horizontal distance of the cell from the rover, D = metres driven since the cell's mean
observation, g = slope, Sigma_xy = horizontal covariance of the cell, Sigma_0 = what a cell has
from the start. All of it is evaluated when the map is read out, relative to the rover's last place.
V_frame and V_drift also widen the gate of new measurements, which differ from the map by them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mapping.errors import MappingError


@dataclass(frozen=True, slots=True)
class PoseErrorModel:
    """Where the errors of a pose source are counted; each of them in one place only.

    The defaults suit an absolute source (motion capture): a pose is right in T up to its own
    covariance, nothing drifts, and standing or moving makes no difference.

    Attributes:
        pose_covariance: the covariance of each pose (z, roll, pitch) enters the measurements of
            its frame, as an error alike for `MapSettings.common_correlation_time_s`. For a source
            that drifts it must hold the part that does not accumulate (levelling), not the drift.
        motion_covariance: the covariance of every `RelativeMotion` grows the covariance of all
            cells (paper eq. 28). Otherwise only its metres count, and of aligned poses the
            covariance of motions on which the map held no frame.
        frame_sigma_m, frame_sigma_rad: height and tilt error of a frame that stands for
            `pose_covariance`.
        drift_per_m: the variance of a frame counts this often again for every metre driven.
        gravity_sigma_rad: tilt of the start against gravity, one draw per run: sigma of the
            accelerometer's bias over g.
        place_sigma_m, heading_sigma_rad: horizontal error of a frame that stands for
            `motion_covariance`; grows with `drift_per_m` too.
    """

    pose_covariance: bool = True
    motion_covariance: bool = False
    frame_sigma_m: float = 0.0
    frame_sigma_rad: float = 0.0
    drift_per_m: float = 0.0
    gravity_sigma_rad: float = 0.0
    place_sigma_m: float = 0.0
    heading_sigma_rad: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what counts an error twice.

        Raises:
            MappingError: a number is negative or not finite, or stands beside what it stands for.
        """
        numbers = self.__dataclass_fields__.keys() - {"pose_covariance", "motion_covariance"}
        for name in sorted(numbers):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise MappingError(f"{name} is {getattr(self, name)}; expected 0 or more")
        for given, names in (
            ("pose_covariance", ("frame_sigma_m", "frame_sigma_rad")),
            ("motion_covariance", ("place_sigma_m", "heading_sigma_rad")),
        ):
            if getattr(self, given) and any(getattr(self, name) > 0.0 for name in names):
                raise MappingError(
                    f"{given} and {' or '.join(names)} above 0 would count one error twice; "
                    "use one of them"
                )


# Motion capture, or true poses.
ABSOLUTE = PoseErrorModel()

# Ego-motion with a filter's covariances and a levelled tilt, without alignment.
RELATIVE = PoseErrorModel(motion_covariance=True)

# Poses aligned to the map; starting values, found on simulated drives with 4 cm cells.
ALIGNED = PoseErrorModel(
    pose_covariance=False,
    frame_sigma_m=0.001,
    frame_sigma_rad=math.radians(0.03),
    drift_per_m=1.0,
    gravity_sigma_rad=math.radians(0.12),
    place_sigma_m=0.003,
    heading_sigma_rad=math.radians(0.05),
)
