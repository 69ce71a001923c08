"""The errors that a user of terravibe may meet, as one line of text each."""


class TerravibeError(Exception):
    """A known failure; its message is one line.

    The line says what was found, what was expected and what to do. Every room's own error
    derives from this class, so that the command line can print the line and exit with 2.
    """


def reason_of(error: Exception) -> str:
    """Return why a file could not be read, without the path, which the message has already."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return "it is no text" if isinstance(error, UnicodeDecodeError) else str(error)


class DriverError(TerravibeError):
    """A device or a folder of device files cannot be opened, or failed while being read."""


class EndOfSource(Exception):  # noqa: N818 - not an error: a finite source has given its last sample
    """Raised by `Source.read` after the last sample of a finite source."""
