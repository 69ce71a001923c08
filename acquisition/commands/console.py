"""What a command may say, and to whom: the command line hands this in, the rooms never print."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from typing import Protocol

OK = 0
CHECK_FAILED = 1


class Board(Protocol):
    """Shows a state that changes once a second."""

    def __call__(self, picture: Callable[[], object], lines: Callable[[], list[str]]) -> None:
        """Show the state; `picture` makes it for a terminal (rich), `lines` what a log is told."""


class Console(Protocol):
    """Where the words of a command go."""

    def lines(self, lines: Iterable[str]) -> None:
        """Print the result, for people."""

    def json(self, value: object) -> None:
        """Print the result, for programs."""

    def note(self, text: str) -> None:
        """Tell the user something beside the result."""

    def progress(self, text: str) -> AbstractContextManager[Callable[[str], None]]:
        """Show that work goes on; the function given takes what has been reached."""

    def board(self) -> AbstractContextManager[Board]:
        """Show a changing state: a picture on a terminal, lines elsewhere."""


class Describable(Protocol):
    """A result in both forms."""

    def as_json(self) -> object:
        """Return JSON values."""

    def describe(self) -> list[str]:
        """Return lines for people."""


def show(console: Console, result: Describable, *, as_json: bool) -> None:
    """Print a result in the form that was asked for."""
    if as_json:
        console.json(result.as_json())
    else:
        console.lines(result.describe())


def prepare_depth_code(console: Console) -> None:
    """Load the code for depth images; where this installation never compiled it, say so and do."""
    from acquisition.messages.depth_rvl import prepare_rvl, rvl_is_cached

    if not rvl_is_cached():
        console.note("compiling the code for depth images; once per installation, a few seconds")
    prepare_rvl()
