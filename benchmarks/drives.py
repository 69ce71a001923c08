"""Simulated drives in memory: what the devices gave, and the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from acquisition.messages.frames import StaticTransform, StaticTransforms
from drivers.errors import EndOfSource
from drivers.samples import Sample
from mapping.geometry import RigidTransform
from simulation.devices.sensor_mounts import sensor_mounts
from simulation.faults import SpinningWheels
from simulation.motion import Motion
from simulation.scenario_source import ScenarioSource
from simulation.scenarios import Scenario, make_scenario

_SPINNING = SpinningWheels(start_s=10.0, duration_s=3.0)


@dataclass(frozen=True, slots=True)
class Drive:
    """What the devices of a drive gave, and the truth."""

    name: str
    seed: int
    scenario: Scenario
    samples: list[Sample]
    motion: Motion

    @property
    def mounts(self) -> StaticTransforms:
        """Where the sensors sit."""
        mounts = sensor_mounts(self.scenario.options, self.scenario.mount)
        return StaticTransforms(self.motion.start_ns, tuple(StaticTransform(*m) for m in mounts))

    def true_pose(self, t_ns: int) -> RigidTransform:
        """Return T_TR at a time."""
        position, quat = self.motion.pose_at(np.array([t_ns]))
        rotation = Rotation.from_quat(quat[0], scalar_first=True).as_matrix()
        return RigidTransform(rotation, position[0])


def make_drive(name: str, seed: int, seconds: float) -> Drive:
    """Drive, and keep all samples in the order of their stamps."""
    scenario = make_scenario("simulation" if name == "spinning" else name, seed, seconds)
    if name == "spinning":
        scenario = replace(scenario, options=replace(scenario.options, faults=(_SPINNING,)))
    source = ScenarioSource(scenario)
    source.open()
    samples: list[Sample] = []
    try:
        while True:
            samples += source.read(0.0)
    except EndOfSource:
        source.close()
    return Drive(name, seed, scenario, samples, source.motion)
