"""An estimated trajectory, and the run that made it, in a few lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

from mapping.odometry_session import OdometryResult


@dataclass(frozen=True, slots=True)
class TimedEvent:
    """Something that the ego-motion suffered from, `t_s` after the first pose."""

    t_s: float
    kind: str
    text: str

    def describe(self) -> str:
        """Return one line."""
        return f"{self.t_s:.2f} s: {self.kind}: {self.text}"


@dataclass(frozen=True, slots=True)
class TrajectorySummary:
    """What was written, and how sure its end is.

    Attributes:
        output: the trajectory's file.
        poses: how many.
        duration_s: from the first to the last.
        end_m: x, y, z of the last, in the terrain frame.
        horizontal_sigma_m: square root of the sum of its variances in x and y.
        notes: where the sensors' sigmas come from.
        warnings: what is doubtful about them.
        events: what the ego-motion suffered from.
    """

    output: str
    poses: int
    duration_s: float
    end_m: tuple[float, float, float]
    horizontal_sigma_m: float
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    events: tuple[TimedEvent, ...]

    def as_json(self) -> dict[str, object]:
        """Return the summary as JSON values, under the names of its attributes."""
        return asdict(self)

    def describe(self) -> list[str]:
        """Return the summary as lines for people."""
        x, y, z = self.end_m
        length = f"{self.poses} poses of {self.duration_s:.1f} s"
        end = f"({x:.3f}, {y:.3f}, {z:.3f}) m, horizontal sigma {self.horizontal_sigma_m:.3f} m"
        return [f"{self.output}: {length}; ends at {end}"]


def summarise_trajectory(
    result: OdometryResult, output: str, losses: Sequence[str] = ()
) -> TrajectorySummary:
    """Return what a run of at least one pose made; `losses`: what of the stream was not used."""
    first_ns, last = result.poses[0].t_ns, result.poses[-1]
    x, y, z = last.transform.translation_m.tolist()
    return TrajectorySummary(
        output=output,
        poses=len(result.poses),
        duration_s=(last.t_ns - first_ns) * 1e-9,
        end_m=(x, y, z),
        horizontal_sigma_m=float(last.covariance.diagonal()[:2].sum() ** 0.5),
        notes=tuple(result.inertial.notes),
        warnings=(*losses, *result.inertial.warnings),
        events=tuple(
            TimedEvent((event.t_ns - first_ns) * 1e-9, str(event.kind), event.text)
            for event in result.events
        ),
    )
