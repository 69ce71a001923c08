"""What is wrong with the printed equations, for those who look at their map."""

_NAIVE = (
    "eqs. 11-15 take all pixels for independent and have neither floor nor gate: what a pose or "
    "the sensor's bias does to all alike is averaged away, and what has moved is averaged in"
)
_FRAME = (
    "eq. 32 turns a lever arm that is in terrain coordinates once more: an error of yaw raises "
    "heights where the rover is tilted (39 mm for 3 degrees, 20 degrees of tilt, 2.2 m)"
)
_STEPS = (
    "eq. 28 adds each step as if it were independent of the last, and eq. 16 forgets what was "
    "added as soon as the cell is measured again"
)
_BOUNDS = "nothing after eq. 55 turns the horizontal covariance into bounds of the height"

FAULTS = (_NAIVE, _FRAME, _STEPS, _BOUNDS)


def describe_faults() -> str:
    """Return the faults as one line."""
    computes = "paper2019 computes what the paper prints, to compare with, not to drive by"
    return f"{computes}: {'; '.join(FAULTS)}"
