"""The recorder's memory: a recording of hours takes what one of a minute takes."""

from __future__ import annotations

import sys
from array import array
from dataclasses import replace
from pathlib import Path
from threading import Event

import pytest

from acquisition.recording.recorder import Recorder
from tests.fakes.recorder_runs import (
    QUICK,
    SecondsClock,
    accelerations,
    output,
    poses,
    tracker,
)
from tests.fakes.scripted_source import ScriptedSource

SETTLED_S, LAST_S = 60, 300


@pytest.mark.skipif(sys.implementation.name != "cpython", reason="counts CPython's own blocks")
def test_a_second_of_recording_leaves_no_memory_behind(tmp_path: Path) -> None:
    """Were one tuple of a second's figures kept, the end would have 240 blocks more."""
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
