"""The filter's state: order, names and frames.

x, y, z       position of base_link in T, metres
yaw           heading of base_link about T's z, radians
speed         u = v (1 + s + k) of the wheels, m/s, with v along base_link's x axis; without wheels
              it is all the same what s and k are
turn          angular rate about base_link's z axis, rad/s
gyro_bias     rad/s
wheel_scale   constant s
slip          k, Gauss-Markov
roll_error, pitch_error    levelled minus true, Gauss-Markov, radians
roll_bias, pitch_bias      levelled minus true, constant, radians
track_error   k of: the wheels' yaw rate = turn (1 + k)
vibration_scale            q of: speed told by the vibration = v (1 + q)
force_error                mean forward force of the last rest minus true, m/s^2
acceleration               of u, Gauss-Markov; 0 at rest and while a force tells that of v
"""

from __future__ import annotations

X, Y, Z, YAW, SPEED, TURN, GYRO_BIAS, WHEEL_SCALE, SLIP = range(9)
ROLL_ERROR, PITCH_ERROR, ROLL_BIAS, PITCH_BIAS, TRACK_ERROR = range(9, 14)
VIBRATION_SCALE, FORCE_ERROR, ACCELERATION = range(14, 17)
SIZE = 17

# Kinds of the filter's input rows, in the order in which rows of one time are taken.
GYRO, WHEELS, VIBRATION, POSE, TICK = range(5)
# Columns of an input row after its kind; what they mean depends on it:
#   GYRO       rate, variance
#   WHEELS     speed, variance, yaw rate, variance, believed (1) or not (0)
#   VIBRATION  speed, variance
#   POSE       row of the table of poses
#   TICK       see below
COLUMNS = 12

# Columns of a TICK row, held until the next one: the levelled tilt (rad, rad/s, rad^2);
TICK_ROLL, TICK_PITCH, TICK_ROLL_RATE, TICK_PITCH_RATE = range(4)
TICK_ROLL_VARIANCE, TICK_PITCH_VARIANCE = 4, 5
# whether the rover stands: 0 it does not, 1 the vibration says so, 2 the wheels as well;
TICK_STILL = 6
# acceleration along x (m/s^2), and what more the speed walks by ((m/s)^2/s);
TICK_FORCE, TICK_SPEED_WALK = 7, 8
# seconds since the tick, of a state that is not at one;
TICK_SINCE_S = 9
# variance of the force at rest ((m/s^2)^2), above 0 where TICK_FORCE refers to a rest;
TICK_REST_VARIANCE = 10
# variance of the slip.
TICK_SLIP_VARIANCE = 11
