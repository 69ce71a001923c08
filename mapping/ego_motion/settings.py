"""What ego-motion assumes of sensors and vehicle: every number with its unit in its name."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from mapping.errors import MappingError

_MAY_BE_ZERO = frozenset(
    {
        "gyro_delay_s",
        "wheels_delay_s",
        "acceleration_delay_s",
        "vibration_delay_s",
        "wheel_scale_walk_per_sqrt_s",
        "gyro_bias_walk_rad_s_per_sqrt_s",
        "lateral_slip_ratio",
        "vertical_walk_ratio",
        "position_floor_m",
        "rotation_floor_rad",
        "vibration_m_s2_per_m_s",
        "vibration_m_per_cycle",
        "gyro_scale_sigma",
    }
)
_ANY_SIGN = frozenset(
    {
        "gyro_zero_rad_s",
        "force_zero_x_m_s2",
        "force_zero_y_m_s2",
        "force_zero_z_m_s2",
        "force_crooked_xy_rad",
        "force_crooked_xz_rad",
        "force_crooked_yz_rad",
    }
)


@dataclass(frozen=True, slots=True)
class EgoMotionSettings:
    """Settings of ego-motion; sigmas are standard deviations.

    Attributes:
        tick_s: grid of sensor time on which tilt and standstill are found and states are kept.
        reorder_window_s: samples later than this behind the newest stamp are left out.
        history_s: how long states are kept for late corrections and relative covariances.
        gyro_delay_s, wheels_delay_s, acceleration_delay_s, vibration_delay_s: by how much the
            stamps are later than the middle of what was measured.
        use_external_poses: take `PoseSample`s as measurements (motion capture).
        gravity_m_s2: at the place of the drive.
        levelling_half_window_s: the tilt at a time is made of accelerations this much around it.
        levelling_sigma_ratio: sigma of the levelled tilt over the residual's scatter / g.
        levelling_floor_rad: the least sigma of the levelled tilt.
        levelling_bias_rad: sigma of its constant part (accelerometer bias and mount).
        levelling_time_s: correlation time of the rest.
        unseen_acceleration_ratio: without wheels: sigma that the rover's own acceleration adds to
            the levelled pitch, over the pitch's scatter within 0.3 s to either side.
        tilt_lost_rad: sigma of roll and pitch while there is no acceleration.
        gyro_noise_rad_s_per_sqrt_hz: white noise of the gyro.
        gyro_bias_rad_s: sigma of the bias at the start.
        gyro_bias_walk_rad_s_per_sqrt_s: its random walk.
        gyro_zero_rad_s, gyro_scale: true rate = scale (rate - zero), of a calibration.
        gyro_scale_sigma: sigma of that scale.
        force_zero_x_m_s2 and y, z; force_scale_x and y, z; force_crooked_xy_rad and xz, yz: of a
            calibration, in the sensor's axes: force = T diag(1/scale) (reading - zero), T upper
            triangular with ones, and minus the angles beside them.
        gyro_gap_s: a gyro silent for longer is lost.
        turn_walk_rad_s2_per_sqrt_hz: how fast the yaw rate changes, as a random walk.
        turn_sigma_rad_s: yaw rates to be expected of the vehicle.
        wheel_scale: sigma of the constant relative error of wheel speeds.
        wheel_scale_walk_per_sqrt_s: its random walk.
        slip: sigma of the slip that comes and goes, relative to the speed.
        slip_time_s: its correlation time.
        slip_surprise: sigma of the slip once wheels have said something impossible.
        slip_lost: sigma of the slip while wheels and gyro disagree about the yaw rate.
        lateral_slip_ratio: sigma of the sideways speed over the forward speed.
        lateral_slip_time_s: its correlation time.
        vertical_walk_ratio: sigma of the vertical speed over the forward speed, beyond what the
            pitch explains (the body heaves); same correlation time.
        track_sigma: relative sigma of the effective track.
        wheel_yaw_correlation_s: how long the error of the wheels' yaw rate stays the same.
        wheels_gap_s: wheels silent for longer are lost.
        acceleration_m_s2: sigma of the vehicle's own acceleration.
        acceleration_time_s: its correlation time.
        ground_tilt_rad: without wheels: sigma of the pitch's changes on ground that looks flat by
            the roll.
        ground_tilt_time_s: correlation time of such changes.
        ground_walk_rad_per_sqrt_s: how fast the ground's slow pitch walks away from that of the
            last rest.
        speed_sigma_m_s: speeds to be expected of the vehicle.
        still_speed_m_s: wheels slower than this may stand.
        still_ratio, moving_ratio: vibration over its level at rest; quiet below the first,
            moving above the second.
        stuck_ratio: above this, wheels that stand are not believed.
        still_margin_s, still_margin_alone_s: the first and last part of a quiet time that does
            not count, with wheels that confirm it and without.
        quiet_m_s2: vibration that counts as rest until rest has been seen.
        zero_speed_m_s, zero_speed_alone_m_s: sigma of the speed at standstill, with wheels that
            confirm it and without.
        zero_rate_rad_s: sigma of the yaw rate at standstill.
        vibration_speed_m_s: sigma of the speed that the vibration tells.
        vibration_speed_time_s: its correlation time.
        vibration_scale: sigma of its constant relative error.
        vibration_m_s2_per_m_s: RMS acceleration of the vibration, summed over the axes, per speed;
            0 = the amplitude tells no speed.
        vibration_m_per_cycle: way per cycle of the strongest vibration; 0 = the frequency tells no
            speed.
        shock_speed_m_s: sigma of what a shock changes of the speed.
        shock_m_s2: an acceleration beyond this is a shock and says nothing about tilt.
        gate_sigma: beyond this a single measurement is not believed.
        pose_gate_probability: an external pose less likely than this is left out.
        position_floor_m, rotation_floor_rad: the least sigmas of an external pose.
    """

    tick_s: float = 0.02
    reorder_window_s: float = 0.25
    history_s: float = 5.0
    gyro_delay_s: float = 0.003
    wheels_delay_s: float = 0.012
    acceleration_delay_s: float = 0.005
    vibration_delay_s: float = 0.13
    use_external_poses: bool = False
    gravity_m_s2: float = 9.80665
    levelling_half_window_s: float = 0.4
    levelling_sigma_ratio: float = 0.3
    levelling_floor_rad: float = 0.0005
    levelling_bias_rad: float = 0.0021
    levelling_time_s: float = 0.3
    unseen_acceleration_ratio: float = 1.5
    tilt_lost_rad: float = 0.2
    gyro_noise_rad_s_per_sqrt_hz: float = 2e-4
    gyro_bias_rad_s: float = 0.02
    gyro_bias_walk_rad_s_per_sqrt_s: float = 3e-5
    gyro_zero_rad_s: float = 0.0
    gyro_scale: float = 1.0
    gyro_scale_sigma: float = 0.0
    force_zero_x_m_s2: float = 0.0
    force_zero_y_m_s2: float = 0.0
    force_zero_z_m_s2: float = 0.0
    force_scale_x: float = 1.0
    force_scale_y: float = 1.0
    force_scale_z: float = 1.0
    force_crooked_xy_rad: float = 0.0
    force_crooked_xz_rad: float = 0.0
    force_crooked_yz_rad: float = 0.0
    gyro_gap_s: float = 0.1
    turn_walk_rad_s2_per_sqrt_hz: float = 0.3
    turn_sigma_rad_s: float = 0.5
    wheel_scale: float = 0.03
    wheel_scale_walk_per_sqrt_s: float = 0.0
    slip: float = 0.06
    slip_time_s: float = 1.0
    slip_surprise: float = 0.5
    slip_lost: float = 1.0
    lateral_slip_ratio: float = 0.06
    lateral_slip_time_s: float = 0.5
    vertical_walk_ratio: float = 0.04
    track_sigma: float = 0.1
    wheel_yaw_correlation_s: float = 0.5
    wheels_gap_s: float = 0.15
    acceleration_m_s2: float = 0.5
    acceleration_time_s: float = 0.2
    ground_tilt_rad: float = 0.01
    ground_tilt_time_s: float = 0.5
    ground_walk_rad_per_sqrt_s: float = 0.002
    speed_sigma_m_s: float = 0.5
    still_speed_m_s: float = 0.01
    still_ratio: float = 1.04
    moving_ratio: float = 1.08
    stuck_ratio: float = 1.5
    still_margin_s: float = 0.1
    still_margin_alone_s: float = 0.5
    quiet_m_s2: float = 0.15
    zero_speed_m_s: float = 0.002
    zero_speed_alone_m_s: float = 0.02
    zero_rate_rad_s: float = 0.001
    vibration_speed_m_s: float = 0.12
    vibration_speed_time_s: float = 0.5
    vibration_scale: float = 0.3
    vibration_m_s2_per_m_s: float = 0.0
    vibration_m_per_cycle: float = 0.0
    shock_m_s2: float = 25.0
    shock_speed_m_s: float = 0.1
    gate_sigma: float = 4.0
    pose_gate_probability: float = 0.001
    position_floor_m: float = 1e-4
    rotation_floor_rad: float = 1e-4

    def __post_init__(self) -> None:
        """Refuse values with which no pose can be found."""
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, bool):
                continue
            if item.name in _ANY_SIGN:
                if not math.isfinite(value):
                    raise MappingError(f"{item.name} is {value}; expected a number")
                continue
            zero_is_fine = item.name in _MAY_BE_ZERO
            low_enough = value >= 0.0 if zero_is_fine else value > 0.0
            if not (low_enough and value < math.inf):
                wanted = "0 or more" if zero_is_fine else "a number above 0"
                raise MappingError(f"{item.name} is {value}; expected {wanted}")
        if self.still_ratio >= self.moving_ratio:
            raise MappingError(
                f"still_ratio is {self.still_ratio} and moving_ratio is {self.moving_ratio}; "
                "expected the first below the second, or standstill will flicker"
            )
        if self.pose_gate_probability >= 1.0:
            raise MappingError(
                f"pose_gate_probability is {self.pose_gate_probability}; expected below 1"
            )
        if self.tick_s > 0.1 or self.levelling_half_window_s < 2.0 * self.tick_s:
            raise MappingError(
                f"tick_s is {self.tick_s} and levelling_half_window_s is "
                f"{self.levelling_half_window_s}; expected a tick of at most 0.1 s and a window of "
                "two ticks or more"
            )
        if self.history_s < 1.0:
            raise MappingError(f"history_s is {self.history_s}; expected 1 s or more")
