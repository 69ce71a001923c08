"""Who stands at the plate, and what a session asks them until the answer can be."""

from __future__ import annotations

from typing import Protocol

from calibration_rigs.plate_rig.cell_checks import tape_doubt
from calibration_rigs.plate_rig.manifest import CORNERS, Rig
from calibration_rigs.plate_rig.session_state import Target

# The answer that leaves the session; everything is saved.
QUIT = "quit"


class Operator(Protocol):
    """Who stands at the plate."""

    def say(self, text: str) -> None:
        """Tell something."""

    def ask(self, question: str) -> str:
        """Return the answer; "quit" ends the session, to be continued later."""

    def wait(self, seconds: float) -> None:
        """Let time pass."""


class SessionLeft(Exception):  # noqa: N818 - not an error: the operator has had enough
    """The operator wants to stop."""


class CellSkipped(Exception):  # noqa: N818 - not an error: the operator goes on
    """The operator leaves a cell out."""


class Questions:
    """Asks an operator. Every question raises SessionLeft when the answer is "quit"."""

    def __init__(self, operator: Operator) -> None:
        self.say = operator.say
        self.wait = operator.wait
        self._ask = operator.ask

    def answer(self, question: str) -> str:
        """Return the answer in lower case.

        Raises:
            SessionLeft: it is "quit".
        """
        answer = self._ask(question).strip().lower()
        if answer == QUIT:
            raise SessionLeft
        return answer

    def number(self, question: str, before: float | None) -> float | None:
        """Return a number; `before` when nothing is typed."""
        while True:
            text = self.answer(question)
            if not text:
                return before
            try:
                return float(text)
            except ValueError:
                self.say(f"{text!r} is no number.")

    def corners_m(self, target: Target, rig: Rig) -> tuple[float, float, float]:
        """Return the tape to the top left, top right and bottom left corner, metres.

        Raises:
            CellSkipped: the operator leaves the cell out.
        """
        question = f"Tape to {', '.join(CORNERS)} corner, in metres, or 'skip':"
        while True:
            words = self.answer(question).replace(",", " ").split()
            if words == ["skip"]:
                raise CellSkipped
            try:
                top_left, top_right, bottom_left = map(float, words)
            except ValueError:
                self.say("Expected three numbers such as 1.002 1.001 1.003.")
                continue
            doubt = tape_doubt((top_left, top_right, bottom_left), target, rig)
            if not doubt or self.answer(f"{doubt} 'yes' if it is right:") == "yes":
                return top_left, top_right, bottom_left

    def keeps(self, *, can_be_kept: bool) -> bool:
        """Return whether a doubtful cell is kept; else it is recorded again.

        Raises:
            CellSkipped: the operator leaves the cell out.
        """
        choices = "'again', 'skip'" + (", 'keep'" if can_be_kept else "")
        while True:
            answer = self.answer(f"{choices} or 'quit':")
            if answer == "skip":
                raise CellSkipped
            if answer == "again" or (answer == "keep" and can_be_kept):
                return answer == "keep"
