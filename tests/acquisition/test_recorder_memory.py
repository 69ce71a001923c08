"""The recorder's memory: a recording of hours takes what one of a minute takes."""

from __future__ import annotations

import sys
from array import array
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Event

import pytest

from acquisition.recording.disk_output import DiskOutput
from acquisition.recording.folder_store import DiskSettings
from acquisition.recording.output import RecordingOutput
from acquisition.recording.recorder import Recorder
from acquisition.recording.ring_output import RingOutput, RingSettings
from acquisition.stream.open_part import PartLimits
from tests.fakes.recorder_runs import QUICK, SecondsClock, accelerations, poses, tracker
from tests.fakes.scripted_source import ScriptedSource

S = 1_000_000_000
SETTLED_S, LAST_S = 60, 200


def in_parts(path: Path) -> DiskOutput:
    limits = PartLimits(duration_ns=20 * S)
    return DiskOutput(path, DiskSettings(limits=limits, reserve_bytes=0, sync_interval_s=0.01))


def in_a_ring(path: Path) -> RingOutput:
    return RingOutput(path, RingSettings(16 * S, reserve_bytes=0))


@pytest.mark.skipif(sys.implementation.name != "cpython", reason="counts CPython's own blocks")
@pytest.mark.parametrize("output", [in_parts, in_a_ring])
def test_a_second_of_recording_leaves_no_memory_behind(
    tmp_path: Path, output: Callable[[Path], RecordingOutput]
) -> None:
    """Were one tuple of a second's figures kept, the end would have 140 blocks more.

    Nor does a part: one begins every few seconds, and 8 blocks of each would be as many.
    """
    blocks = array("q")  # which itself takes one block, however long
    stop = Event()

    def beat(_: object) -> None:
        blocks.append(sys.getallocatedblocks())
        if len(blocks) == LAST_S:
            stop.set()

    imu = ScriptedSource("imu", accelerations(0, 9), goes_on=True)
    mocap = tracker(poses(9), goes_on=True)
    plan = replace(QUICK, flush_interval_s=0.0)
    Recorder([imu, mocap], output(tmp_path / "r.mcap"), plan, SecondsClock()).run(stop, beat)
    assert min(blocks[-20:]) - min(blocks[SETTLED_S : SETTLED_S + 20]) < (LAST_S - SETTLED_S) / 4
