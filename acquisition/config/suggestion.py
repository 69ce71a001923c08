"""What somebody who wrote an unknown name may have meant."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def suggestion(name: str, known: Iterable[str], *, likeness: float = 0.6) -> str:
    """Return "did you mean ...?" with the known name that is most like this one, or "".

    `likeness`: from 0, anything will do, to 1, only the same; see `difflib`.
    """
    close = get_close_matches(name, list(known), n=1, cutoff=likeness)
    return f"did you mean {close[0]}?" if close else ""
