"""The error of the stream: what cannot be written, read or understood."""

from drivers.errors import TerravibeError


class StreamError(TerravibeError):
    """A stream or a message in it cannot be written, read or understood; one line of text."""
