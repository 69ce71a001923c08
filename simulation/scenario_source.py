"""A scenario as a source: what all its devices report, in the order of the stamps."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.errors import DriverError, EndOfSource
from drivers.faults import NO_FAULTS, Faults
from drivers.samples import (
    AccelerationSample,
    CanFrameSample,
    DepthFrame,
    PoseSample,
    Sample,
    VibrationSample,
    WheelTwistSample,
    YawRateSample,
    frozen_array,
)
from drivers.source import SourceInfo, TickCounter
from simulation.devices.depth_faults import with_patches
from simulation.errors import SimulationError
from simulation.faults import arriving
from simulation.motion import STEP_NS, Motion
from simulation.scenarios import Scenario
from simulation.truth import SeenCells, Truth
from simulation.truth_file import motion_signals, write_truth_file
from simulation.vehicle.vehicle_run import VehicleRun, simulate_vehicle

# The map's own default, so that truth and map share their cells.
TRUTH_CELL_M = 0.04
_DEPTH_PERIOD_NS = 100_000_000
_POSE_PERIOD_NS = 10_000_000
_BATCH = 256
_DEPTH_FAULTS = 1_000_000  # beyond the numbers of frames, which seed their own noise
_KINDS = (
    PoseSample,
    DepthFrame,
    VibrationSample,
    AccelerationSample,
    YawRateSample,
    CanFrameSample,
    WheelTwistSample,
)


class ScenarioSource:
    """Source of all devices of a simulated rover; opening it drives, reading it looks.

    Depth frames (10 Hz) and true poses (100 Hz, one at every depth frame) have exact stamps; the
    stamps of the other devices are as late as theirs are.

    Args:
        scenario: what is simulated.
        name: the instance's name.
        on_progress: told the driven seconds now and then while it opens.
    """

    def __init__(
        self,
        scenario: Scenario,
        name: str = "rover",
        on_progress: Callable[[float], None] | None = None,
    ) -> None:
        self.name = name
        self.scenario = scenario
        self._on_progress = on_progress
        self._run: VehicleRun | None = None
        self._samples: Iterator[Sample] | None = None
        self._seen = SeenCells(TRUTH_CELL_M)

    @property
    def motion(self) -> Motion:
        """Return how the rover truly moved.

        Raises:
            SimulationError: it was never opened.
        """
        if self._run is None:
            raise SimulationError(f"{self.name}: it has not driven yet; open it first")
        return self._run.motion

    @property
    def faults(self) -> Faults:
        """None: nothing is lost on the way from a simulated device."""
        return NO_FAULTS

    def open(self) -> SourceInfo:
        """Drive, and start at the beginning of the samples.

        Raises:
            SimulationError: the vehicle fell over or left the ground.
        """
        wanted, vibration = self.scenario, self.scenario.options.vibration
        if self._run is None:
            self._run = simulate_vehicle(
                wanted.ground,
                wanted.commands,
                wanted.seconds,
                wanted.seed,
                wanted.options,
                self._on_progress,
            )
        self._seen = SeenCells(TRUTH_CELL_M)
        self._samples = self._merged(self._run)
        return SourceInfo(
            name=self.name,
            model=f"simulated rover, scenario {wanted.name}",
            serial="",
            produces=_KINDS,
            time_base="recorded",
            details=self._details(),
            counter=TickCounter(1.0 / vibration.tick_s, vibration.wrap_ticks),
        )

    def _details(self) -> dict[str, str]:
        wanted = self.scenario
        return {
            "scenario": wanted.name,
            "seed": str(wanted.seed),
            "seconds": f"{wanted.seconds:g}",
            "poses": wanted.poses,
        }

    def read(self, timeout_s: float) -> Sequence[Sample]:  # noqa: ARG002 - never waits
        """Return the next samples.

        Raises:
            DriverError: not open.
            EndOfSource: the run is over.
        """
        if self._samples is None:
            raise DriverError(f"{self.name}: read before open")
        batch = list(islice(self._samples, _BATCH))
        if not batch:
            raise EndOfSource(f"{self.name}: end of the run")
        return batch

    def close(self) -> None:
        """Forget where the reading was; harmless when closed."""
        self._samples = None

    def truth(self) -> Truth:
        """Return the ground around everything that the depth frames read so far could show.

        Raises:
            SimulationError: nothing was seen.
        """
        return self._seen.truth(self.scenario.ground.height_at)

    def write_truth(self, path: Path) -> None:
        """Write what is true of the run; see `simulation.truth_file.write_truth_file`.

        Raises:
            SimulationError: it was never opened, nothing was seen, or the file cannot be written.
        """
        known = motion_signals(self.motion)
        facts: dict[str, str | float] = {**self._details(), "stuck_s": self.motion.stuck_s}
        write_truth_file(path, self.truth(), self.scenario.ground, known, facts)

    def _merged(self, run: VehicleRun) -> Iterator[Sample]:
        """Return all samples by their stamps; of equal ones the pose comes first."""
        exact = self.scenario.poses == "true"
        streams: list[Iterator[Sample]] = [_true_poses(run.motion)] if exact else []
        streams += [iter(s) for s in run.streams if not (exact and s.kind is PoseSample)]
        streams.append(self._depth(run.motion))
        return heapq.merge(*streams, key=lambda sample: sample.t_ns)

    def _depth(self, motion: Motion) -> Iterator[Sample]:
        """Yield the camera's frames that get through, and remember what they could show."""
        camera, mount, seed = self.scenario.camera, self.scenario.mount, self.scenario.seed
        faults = self.scenario.options.faults
        elapsed_ns = np.arange(0, motion.duration_ns, _DEPTH_PERIOD_NS)
        elapsed_s = np.asarray(elapsed_ns * 1e-9, np.float64)
        chance = np.random.default_rng([seed, _DEPTH_FAULTS])
        arrived = arriving(faults, "depth", elapsed_s, chance)
        everywhere = np.ones((camera.camera.height_px, camera.camera.width_px), np.bool_)
        for index in np.flatnonzero(arrived).tolist():
            row = int(elapsed_ns[index]) // STEP_NS
            body = Rotation.from_quat(motion.quat_wxyz[row], scalar_first=True).as_matrix()
            pose = mount.camera_pose(motion.position_m[row], body)
            view = camera.look(*pose)
            self._seen.add(camera.visible_points(view, *pose, everywhere))
            frame = camera.frame(view, index, motion.start_ns + int(elapsed_ns[index]))
            yield with_patches(frame, faults, float(elapsed_s[index]), seed)


def _true_poses(motion: Motion) -> Iterator[Sample]:
    """Yield exact poses with a covariance of 0."""
    covariance = frozen_array(np.zeros((6, 6)), (6, 6))
    for index, elapsed_ns in enumerate(range(0, motion.duration_ns + 1, _POSE_PERIOD_NS)):
        row = elapsed_ns // STEP_NS
        position = frozen_array(motion.position_m[row], (3,))
        quat = frozen_array(motion.quat_wxyz[row], (4,))
        yield PoseSample(motion.start_ns + elapsed_ns, position, quat, covariance, index)
