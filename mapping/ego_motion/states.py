"""The filter's state: order, names and frames.

x, y, z       position of base_link in T, metres
yaw           heading of base_link about T's z, radians
speed         along base_link's x axis, m/s
turn          angular rate about base_link's z axis, rad/s
gyro_bias     rad/s
wheel_scale   constant s of: wheel speed = speed (1 + s + slip)
slip          Gauss-Markov part of the same
roll_error, pitch_error    levelled minus true, Gauss-Markov, radians
roll_bias, pitch_bias      levelled minus true, constant, radians
track_error   k of: the wheels' yaw rate = turn (1 + k)
vibration_scale            q of: speed told by the vibration = speed (1 + q)
"""

from __future__ import annotations

X, Y, Z, YAW, SPEED, TURN, GYRO_BIAS, WHEEL_SCALE, SLIP = range(9)
ROLL_ERROR, PITCH_ERROR, ROLL_BIAS, PITCH_BIAS, TRACK_ERROR, VIBRATION_SCALE, FORCE_ERROR = range(
    9, 16
)
SIZE = 16

# Kinds of the filter's input rows, in the order in which rows of one time are taken.
GYRO, WHEELS, VIBRATION, POSE, TICK = range(5)
# Columns of an input row after its kind; what they mean depends on it:
#   GYRO       rate, variance
#   WHEELS     speed, variance, yaw rate, variance, believed (1) or not (0)
#   VIBRATION  speed, variance
#   POSE       row of the table of poses
#   TICK       roll, pitch, roll rate, pitch rate, roll variance, pitch variance, still (0, 1, 2),
#              acceleration along x, walk of the speed (variance per second), seconds since the
#              tick, variance of the force at rest (above 0: the acceleration is relative to it)
COLUMNS = 11
