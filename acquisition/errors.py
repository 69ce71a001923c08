"""The errors of this room: a stream, the recorder, the configuration."""

from drivers.errors import TerravibeError


class StreamError(TerravibeError):
    """A stream or a message in it cannot be written, read or understood; one line of text."""


class OutputEndedError(StreamError):
    """No folder that the recording may go to can take more; what was written before is readable."""


class RecorderError(TerravibeError):
    """Recording cannot start: what is missing, and what to do about it; one line of text."""


class ConfigError(TerravibeError):
    """rover.toml is not usable: file, line, what was found and what was expected."""
