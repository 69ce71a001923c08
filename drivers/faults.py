"""What went wrong between a device and its samples, counted by name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Faults:
    """Counts that only grow while a source is open.

    Attributes:
        lost: name -> how often something that the device sent did not become a sample.
        mended: name -> how often something failed and was put right without a loss.
    """

    lost: Mapping[str, int] = field(default_factory=dict)
    mended: Mapping[str, int] = field(default_factory=dict)

    def since(self, before: Faults) -> Faults:
        """Return what has been added to `before`, under the names that are here."""
        return Faults(
            _changed(self.lost, before.lost, -1), _changed(self.mended, before.mended, -1)
        )

    def plus(self, earlier: Faults) -> Faults:
        """Return the sums, under the names that are here or there."""
        return Faults(
            _changed(dict.fromkeys(earlier.lost, 0) | dict(self.lost), earlier.lost, 1),
            _changed(dict.fromkeys(earlier.mended, 0) | dict(self.mended), earlier.mended, 1),
        )

    def losses(self) -> list[str]:
        """Return each loss that happened in words, such as "3 checksum errors"."""
        return list(_in_words(self.lost))

    def repairs(self) -> list[str]:
        """Return each repair that happened in words."""
        return list(_in_words(self.mended))


NO_FAULTS = Faults()


def _changed(counts: Mapping[str, int], by: Mapping[str, int], sign: int) -> dict[str, int]:
    return {name: count + sign * by.get(name, 0) for name, count in counts.items()}


def _in_words(counts: Mapping[str, int]) -> Iterator[str]:
    return (f"{count} {name.replace('_', ' ')}" for name, count in counts.items() if count)
