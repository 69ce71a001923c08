"""What can go wrong in the simulator, as one line of text."""

from drivers.errors import TerravibeError


class SimulationError(TerravibeError):
    """A world, vehicle or drive cannot be made as asked, or its truth cannot be written."""
