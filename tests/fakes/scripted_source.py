"""A source that does what a script says, at once; it does not fake time, threads or a bus."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from threading import Event

from drivers.errors import EndOfSource
from drivers.faults import NO_FAULTS, Faults
from drivers.samples import AccelerationSample, Sample
from drivers.source import SourceInfo, TickCounter, TimeBase

# What one read does: give samples, raise, or run something and then give nothing.
Step = Sequence[Sample] | Exception | Callable[[], object]


class ScriptedSource:
    """Implements `drivers.source.Source`; ends with the script unless it is to go on."""

    def __init__(
        self,
        name: str,
        script: Iterable[Step],
        *,
        produces: tuple[type[Sample], ...] = (AccelerationSample,),
        opens: Sequence[Exception | None] = (),
        time_base: TimeBase = "monotonic",
        rates_hz: dict[type[Sample], float] | None = None,
        goes_on: bool = False,
        counter: TickCounter | None = None,
        faults: Sequence[Faults] = (),
    ) -> None:
        self.name = name
        self.opened = 0
        self.closed = 0
        self.exhausted = Event()
        self._script = iter(script)
        self._opens = list(opens)
        self._faults = list(faults)
        self.faults = NO_FAULTS
        self._goes_on = goes_on
        self._pause = Event()
        self._info = SourceInfo(
            name, "script", f"{name}-1", produces, time_base, {}, rates_hz or {}, counter
        )

    def open(self) -> SourceInfo:
        """Succeed or fail, as the next entry of `opens` says; succeed when there is none."""
        self.opened += 1
        if self._opens:
            problem = self._opens.pop(0)
            if problem is not None:
                raise problem
        return self._info

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """Do the next step, with the next entry of `faults` if there is one.

        Nothing is there at once: who does not wait (a recorder that has not begun) gets nothing.
        """
        if timeout_s == 0.0:
            return ()
        step = next(self._script, None)
        if self._faults:
            self.faults = self._faults.pop(0)
        if step is None:
            self.exhausted.set()
            if not self._goes_on:
                raise EndOfSource
            self._pause.wait(min(timeout_s, 0.005))
            return ()
        if isinstance(step, Exception):
            raise step
        if callable(step):
            step()
            return ()
        return step

    def close(self) -> None:
        """Count."""
        self.closed += 1
