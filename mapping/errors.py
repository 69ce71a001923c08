"""The error of the mapping room."""

from drivers.errors import TerravibeError


class MappingError(TerravibeError):
    """A map cannot be made, read or written; the message says why and what to do."""
