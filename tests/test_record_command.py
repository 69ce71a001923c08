"""`terravibe record` on a disk that fills up: what it exits with, says, and leaves behind."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import cli
from acquisition.commands.console import CHECK_FAILED, OK
from acquisition.stream.parts import read_parts
from drivers.samples import AccelerationSample, Sample, frozen_array
from tests.acquisition.test_stream_writer import files_may_grow_to
from tests.fakes.recordings import recording, same

# More than the largest chunk takes: a replay as fast as it goes fills chunks to their limit.
DISK_BYTES = 600_000


@pytest.fixture(scope="module")
def played() -> list[Sample]:
    """Return more accelerations than the disk has room for, which no compression makes small."""
    values = np.random.default_rng(1).normal(0.0, 1.0, (30_000, 3))
    return [
        AccelerationSample(10**18 + 5_000_000 * i, frozen_array(row, (3,)), i)
        for i, row in enumerate(values)
    ]


def rover_file(folder: Path, played: list[Sample], fallback: str = "") -> Path:
    """Write a rover.toml that records a replayed recording into that folder."""
    (folder / "played.mcap").write_bytes(recording(played))
    path = folder / "rover.toml"
    path.write_text(
        f"""
[recording]
disk_reserve_mb = 0
flush_ms = 5
{fallback}
[[devices]]
kind = "replay"
path = "{folder / "played.mcap"}"
speed = 0.0
"""
    )
    return path


def record(config: Path, output: Path) -> int:
    """Record until the replay ends or a file reaches the size of the disk."""
    with files_may_grow_to(DISK_BYTES):
        return cli.main(["record", "--config", str(config), "-o", str(output), "--json"])


def samples_of(files: list[str]) -> list[Sample]:
    found = [message.sample for message in read_parts([Path(file) for file in files])]
    return [sample for sample in found if isinstance(sample, Sample)]


def test_a_full_disk_is_told_fails_the_command_and_loses_nothing_flushed(
    tmp_path: Path, played: list[Sample], capsys: pytest.CaptureFixture[str]
) -> None:
    assert record(rover_file(tmp_path, played), tmp_path / "r.mcap") == CHECK_FAILED
    said = capsys.readouterr()
    told = json.loads(said.out)
    assert told["outcome"] == "output_failed"
    assert f"{told['unwritten']} samples were read but could not be written" in said.err
    assert "File too large" in told["message"]
    assert "what was flushed is readable; make room or give a fallback folder" in told["message"]
    assert "\n" not in told["message"]
    kept = samples_of(told["files"])
    assert len(kept) > 100
    assert all(map(same, kept, played))
    (source,) = told["health"]["sources"]
    handed_on = sum(stream["statistics"]["samples"] for stream in source["streams"])
    read = handed_on + source["queue"]["samples"]
    # All that was read is in the file or counted; health records may be among what is counted.
    assert 0 <= told["unwritten"] - (read - len(kept)) <= told["health"]["elapsed_s"] + 1


def test_with_somewhere_else_to_go_the_recording_is_whole(
    tmp_path: Path, played: list[Sample], capsys: pytest.CaptureFixture[str]
) -> None:
    others = [tmp_path / f"disk{number}" for number in range(9)]
    for folder in others:
        folder.mkdir()
    fallback = f"fallback_folders = {json.dumps([str(folder) for folder in others])}"
    assert record(rover_file(tmp_path, played, fallback), tmp_path / "r.mcap") == OK
    told = json.loads(capsys.readouterr().out)
    assert (told["outcome"], told["unwritten"]) == ("ended", 0)
    assert len(told["files"]) > 1
    kept = samples_of(told["files"])
    assert len(kept) == len(played)
    assert all(map(same, kept, played))


def test_a_ring_that_nothing_triggered_says_that_there_is_no_file(
    tmp_path: Path, played: list[Sample], capsys: pytest.CaptureFixture[str]
) -> None:
    config = rover_file(tmp_path, played[:100], "ring_s = 5.0")
    assert cli.main(["record", "--config", str(config), "-o", str(tmp_path / "r.mcap")]) == OK
    assert "no file was written; a ring is written at SIGUSR1" in capsys.readouterr().out
    assert not list(tmp_path.glob("r*.mcap"))
