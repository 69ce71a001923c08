"""Fields of a sample that its main message has no room for, and their way back to it.

The main message of a sample is one that other programs know (Imu, Image, TwistWithCovariance);
what does not fit travels in a second message with the same stamp, written right before it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from drivers.samples import Sample

# Over a minute at 1 kHz, far more than a reorder window holds; they wait as long as that only
# where main messages were lost.
_MOST_REMEMBERED = 1 << 16


@dataclass(frozen=True, slots=True)
class Companion:
    """Further fields of the sample with the same time.

    Attributes:
        t_ns: time of the sample.
        sample_type: of which type the sample is.
        fields: values by the names that they have in the sample.
    """

    t_ns: int
    sample_type: type[Sample]
    fields: Mapping[str, Any]


class Companions:
    """Remembers companions until the samples leave that they belong to."""

    def __init__(self) -> None:
        self._waiting: dict[tuple[type, int], list[Companion]] = {}

    def add(self, companion: Companion) -> None:
        """Take a companion; it may come before or after its main message in the file."""
        key = (companion.sample_type, companion.t_ns)
        self._waiting.setdefault(key, []).append(companion)
        if len(self._waiting) > _MOST_REMEMBERED:
            del self._waiting[next(iter(self._waiting))]

    def take(self, sample_type: type, t_ns: int) -> Mapping[str, Any]:
        """Return the further fields of a sample and forget them; empty when none came.

        Samples of the same type and time get theirs in the order of arrival.
        """
        key = (sample_type, t_ns)
        waiting = self._waiting.get(key)
        if waiting is None:
            return {}
        companion = waiting.pop(0)
        if not waiting:
            del self._waiting[key]
        return companion.fields
