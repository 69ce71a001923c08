"""The error of the calibration rigs."""

from drivers.errors import TerravibeError


class RigError(TerravibeError):
    """A calibration cannot be made of what was recorded; the message says why and what to do."""
