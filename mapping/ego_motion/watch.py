"""What went wrong: sensors that fall silent, wheels against vibration, shocks; each said once."""

from __future__ import annotations

from mapping.ego_motion.blocks import Blocks
from mapping.ego_motion.events import EgoEvent, EventKind
from mapping.ego_motion.filter import Surprise
from mapping.ego_motion.filter_types import Int64Array
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.ego_motion.standstill import BoolArray, Motionless
from mapping.ego_motion.states import WHEELS

_FORGET_NS = 1_000_000_000  # the same trouble is a new event after so long without it
_MOST_EVENTS = 10_000


class HealthWatch:
    """Collects events.

    Attributes:
        events: in the order in which they were noticed; after 10000 no more are kept.
    """

    def __init__(self, settings: EgoMotionSettings) -> None:
        self._settings = settings
        self.events: list[EgoEvent] = []
        self._heard: dict[str, bool] = {}
        self._last_ns: dict[EventKind, int] = {}

    def tell(self, t_ns: int, kind: EventKind, text: str) -> None:
        """Add an event, unless the same kind was there within the last second."""
        last_ns = self._last_ns.get(kind)
        self._last_ns[kind] = t_ns
        if (last_ns is None or t_ns - last_ns > _FORGET_NS) and len(self.events) < _MOST_EVENTS:
            self.events.append(EgoEvent(t_ns, kind, text))

    def look(self, blocks: Blocks) -> None:
        """Look for sensors that fall silent or come back, and for shocks."""
        self._silence(blocks.t_ns, blocks.gyro_ok, "gyro_lost", "gyro_back")
        self._silence(blocks.t_ns, blocks.wheels_ok, "wheels_lost", "wheels_back")
        self._silence(blocks.t_ns, blocks.count > 0, "acceleration_lost", "acceleration_back")
        limit = self._settings.shock_m_s2
        for t_ns in blocks.t_ns[blocks.shock].tolist():
            self.tell(t_ns, "shock", f"an acceleration above {limit:g} m/s^2; tilt is held")

    def judge(self, ticks_ns: Int64Array, motionless: Motionless) -> None:
        """Look for wheels that stand although the rover moves."""
        for t_ns in ticks_ns[motionless.stuck].tolist():
            self.tell(t_ns, "wheels_stuck", "wheels say 0 while the rover vibrates; not believed")

    def doubt(self, ticks_ns: Int64Array, lost: BoolArray) -> None:
        """Look for wheels that turn the rover otherwise than it turns."""
        for t_ns in ticks_ns[lost].tolist():
            self.tell(t_ns, "wheels_slip", "wheels and gyro disagree; the wheels are not believed")

    def surprise(self, surprises: list[Surprise]) -> None:
        """Tell what the filter did not believe."""
        for item in surprises:
            if item.kind == WHEELS:
                text = f"a wheel speed that cannot be (NIS {item.nis:.0f}); taken for slip"
                self.tell(item.t_ns, "wheels_slip", text)
            else:
                text = f"an external pose too far off (NIS {item.nis:.0f}); left out"
                self.tell(item.t_ns, "pose_rejected", text)

    def _silence(
        self, t_ns: Int64Array, heard: BoolArray, lost: EventKind, back: EventKind
    ) -> None:
        """Tell changes; a sensor that never was there is not lost."""
        for now_ns, is_heard in zip(t_ns.tolist(), heard.tolist(), strict=True):
            before = self._heard.get(lost)
            if is_heard:
                if before is False:
                    self.tell(now_ns, back, f"{back.split('_')[0]} reports again")
                self._heard[lost] = True
            elif before:
                self.tell(now_ns, lost, f"{lost.split('_')[0]} is silent; uncertainty grows")
                self._heard[lost] = False
