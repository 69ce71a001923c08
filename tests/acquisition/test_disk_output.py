"""A recording on disk: in parts, from folder to folder, and what a full or failing disk does."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader

from acquisition.errors import OutputEndedError, StreamError
from acquisition.health.diagnostics import Diagnostics
from acquisition.messages.frames import StaticTransforms
from acquisition.recording.disk_output import DiskOutput
from acquisition.recording.folder_store import DiskSettings
from acquisition.recording.intake import Stamped
from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.open_part import NO_LIMITS, PartLimits
from acquisition.stream.parts import part_path, parts_of, read_parts
from acquisition.stream.reader import StreamReader
from acquisition.stream.split_writer import STATISTICS_NAME, Head
from drivers.samples import DepthFrame, Sample
from tests.acquisition.test_stream_writer import files_may_grow_to
from tests.fakes.recordings import MOUNT, SETTINGS, SOURCE, acceleration, pose, same, samples

SAMPLES = samples(1.0)


def head(recording: str = "r1") -> Head:
    return Head(recording, [SOURCE], [Diagnostics], [MOUNT], SETTINGS, lambda: {"lost": "none"})


def stamped(content: Sequence[Sample]) -> list[Stamped]:
    return [Stamped(sample.t_ns, sample) for sample in content]


def settings(limits: PartLimits = NO_LIMITS, *folders: Path, reserve: int = 0) -> DiskSettings:
    return DiskSettings(folders, limits, reserve, sync_interval_s=60.0)


def write_in_batches(output: DiskOutput, content: Sequence[Sample], size: int = 20) -> None:
    for start in range(0, len(content), size):
        output.write(stamped(content[start : start + size]))


def recorded(path: Path, limits: PartLimits) -> tuple[Path, ...]:
    output = DiskOutput(path, settings(limits))
    output.start(head())
    write_in_batches(output, SAMPLES)
    return output.close()


def content_of(paths: Sequence[Path]) -> list[Sample]:
    found = [message.sample for message in read_parts(paths)]
    return [sample for sample in found if isinstance(sample, Sample)]


@pytest.mark.parametrize(
    "limits", [PartLimits(size_bytes=3000), PartLimits(duration_ns=200_000_000)]
)
def test_parts_play_as_one_recording(tmp_path: Path, limits: PartLimits) -> None:
    files = recorded(tmp_path / "r.mcap", limits)
    assert len(files) >= 4
    assert [path.name for path in files[:2]] == ["r.mcap", "r_001.mcap"]
    assert parts_of(tmp_path / "r.mcap") == list(files) == parts_of(files[0])
    played = content_of(files)
    assert len(played) == len(SAMPLES)
    assert all(map(same, played, SAMPLES))


def test_each_part_opens_alone_and_knows_everything(tmp_path: Path) -> None:
    files = recorded(tmp_path / "r.mcap", PartLimits(duration_ns=200_000_000))
    for path in files:
        with Reader(path) as bag:
            assert bag.message_count == len(list(bag.messages())) > 0
            assert "/tf_static" in {connection.topic for connection in bag.connections}
        with FinishedFile(path) as file:
            reader = StreamReader(file)
            messages = list(reader)
        assert isinstance(messages[0].sample, StaticTransforms)
        assert reader.report.complete
        assert reader.metadata["terravibe"]["settings"]
        assert reader.metadata[STATISTICS_NAME] == {"lost": "none"}


def test_parts_of_different_recordings_are_not_mixed(tmp_path: Path) -> None:
    first = recorded(tmp_path / "a.mcap", NO_LIMITS)
    other = DiskOutput(tmp_path / "b.mcap", settings())
    other.start(head("r2"))
    other.write(stamped(SAMPLES))
    with pytest.raises(StreamError, match="is no part of recording 'r1' but of 'r2'"):
        list(read_parts([*first, *other.close()]))


def test_no_part_at_all_is_told(tmp_path: Path) -> None:
    with pytest.raises(StreamError, match="no recording"):
        parts_of(tmp_path / "r.mcap")


@pytest.mark.parametrize("limits", [NO_LIMITS, PartLimits(duration_ns=10**12)])
def test_a_recording_in_one_part_has_the_name_that_was_given(
    tmp_path: Path, limits: PartLimits
) -> None:
    path = tmp_path / "r_001.mcap"
    assert recorded(path, limits) == (path,)
    assert parts_of(path) == [path]
    assert part_path(path, 12) == tmp_path / "r_001_012.mcap"


def test_at_the_reserve_the_recording_is_completed_and_says_so(tmp_path: Path) -> None:
    room = iter([10, 10, 5])
    output = DiskOutput(tmp_path / "r.mcap", settings(reserve=6), free=lambda _: next(room, 5))
    output.start(head())
    output.write(stamped(SAMPLES))
    output.tend()
    with pytest.raises(OutputEndedError, match="0 MB left, the reserve is 0 MB; the recording"):
        output.tend()
    (path,) = output.close()
    with Reader(path) as bag:
        assert bag.message_count > len(SAMPLES)
    assert len(content_of([path])) == len(SAMPLES)


def test_recording_goes_on_in_the_next_folder_with_room(tmp_path: Path) -> None:
    other = tmp_path / "stick"
    other.mkdir()
    free = {tmp_path: 100, other: 100}
    output = DiskOutput(tmp_path / "r.mcap", settings(NO_LIMITS, other, reserve=6), free=free.get)  # type: ignore[arg-type] # every folder is in it
    output.start(head())
    write_in_batches(output, SAMPLES[:100])
    free[tmp_path] = 0
    output.tend()
    write_in_batches(output, SAMPLES[100:])
    assert "0 MB left" in output.state().warnings[0]
    files = output.close()
    assert files == (tmp_path / "r.mcap", other / "r_001.mcap")
    assert parts_of(tmp_path / "r.mcap", [other]) == list(files)
    assert len(content_of(files)) == len(SAMPLES)
    for path in files:
        with Reader(path) as bag:
            assert bag.message_count


def test_a_part_that_fails_loses_nothing_and_the_recording_goes_on_elsewhere(
    tmp_path: Path,
) -> None:
    other = tmp_path / "stick"
    other.mkdir()
    output = DiskOutput(tmp_path / "r.mcap", settings(NO_LIMITS, other))
    output.start(head())
    write_in_batches(output, SAMPLES[:200])
    # The kernel tears the next chunk; the new file in the other folder is below the limit.
    with files_may_grow_to(output.state().bytes_written + 40):
        output.write(stamped(SAMPLES[200:220]))
    assert "File too large" in output.state().warnings[0]
    write_in_batches(output, SAMPLES[220:])
    files = output.close()
    assert files == (tmp_path / "r.mcap", other / "r_001.mcap")
    assert len(content_of(files[:1])) == 200
    played = content_of(files)
    assert len(played) == len(SAMPLES)
    assert all(map(same, played, SAMPLES))


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Mount a disk of 256 kB, or skip."""
    folder = tmp_path / "small"
    folder.mkdir()
    if os.geteuid() != 0:
        pytest.skip("only root may mount a small disk")
    command = ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(folder)]
    mounted = subprocess.run(command, capture_output=True, check=False)
    if mounted.returncode != 0:
        pytest.skip(f"no tmpfs here: {mounted.stderr.decode().strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def test_a_disk_that_is_full_in_earnest(small_disk: Path, tmp_path: Path) -> None:
    many = samples(20.0)
    output = DiskOutput(small_disk / "r.mcap", settings(NO_LIMITS, tmp_path))
    output.start(head())
    write_in_batches(output, many)
    state = output.state()
    files = output.close()
    assert "No space left on device" in state.warnings[0]
    assert state.flushed == len(many)
    assert files == (small_disk / "r.mcap", tmp_path / "r_001.mcap")
    played = content_of(files)
    assert len(played) == len(many)
    assert all(map(same, played, many))


def test_a_disk_that_is_full_and_nowhere_to_go(small_disk: Path) -> None:
    output = DiskOutput(small_disk / "r.mcap", settings())
    output.start(head())
    many = samples(20.0)
    with pytest.raises(OutputEndedError, match="what was flushed is readable"):
        write_in_batches(output, many)
    flushed = output.state().flushed
    (path,) = output.close()
    played = content_of([path])
    assert 100 < flushed == len(played)
    assert all(map(same, played, many))


def test_a_folder_that_is_gone_is_told(tmp_path: Path) -> None:
    output = DiskOutput(tmp_path / "gone" / "r.mcap", settings())
    with pytest.raises(OutputEndedError, match=r"cannot record into .*gone: No such file"):
        output.start(head())


def test_it_does_not_write_before_it_was_started(tmp_path: Path) -> None:
    output = DiskOutput(tmp_path / "r.mcap")
    with pytest.raises(StreamError, match="not started"):
        output.write([])
    assert output.close() == ()


def test_a_late_source_is_in_every_later_part(tmp_path: Path) -> None:
    limits = PartLimits(duration_ns=100_000_000)
    output = DiskOutput(tmp_path / "r.mcap", settings(limits))
    imu = SOURCE.__class__("imu", "chip", "", (type(acceleration(0)),), "recorded")
    tracker = SOURCE.__class__("tracker", "mocap", "", (type(pose(0)),), "recorded")
    output.start(Head("r1", [imu], [], [], {}, dict))
    output.write(stamped([acceleration(0)]))
    output.add_source(tracker)
    later = [acceleration(1).t_ns + i * 60_000_000 for i in range(4)]
    output.write(stamped([pose(i, t_ns) for i, t_ns in enumerate(later)]))
    files = output.close()
    assert len(files) == 2
    for path in files:
        with Reader(path) as bag:
            assert "/mocap/pose" in {connection.topic for connection in bag.connections}
    assert [type(sample) for sample in content_of(files)].count(DepthFrame) == 0


def test_a_place_that_takes_not_even_the_head_is_left_without_a_trace(tmp_path: Path) -> None:
    other = tmp_path / "stick"
    other.mkdir()
    output = DiskOutput(tmp_path / "r.mcap", settings(NO_LIMITS, other))
    with files_may_grow_to(10), pytest.raises(OutputEndedError, match="File too large"):
        output.start(head())
    assert output.close() == ()
    assert [path.name for path in tmp_path.rglob("*")] == ["stick"]


def test_a_place_that_fails_right_behind_the_head_is_left_as_well(tmp_path: Path) -> None:
    output = DiskOutput(tmp_path / "r.mcap", settings())
    whole = DiskOutput(tmp_path / "whole.mcap", settings())
    whole.start(head())
    head_bytes = whole.state().bytes_written
    whole.close()
    with files_may_grow_to(head_bytes - 1), pytest.raises(OutputEndedError, match="too large"):
        output.start(head())
    assert output.close() == ()


@pytest.mark.parametrize("where", ["", "stick"])
def test_a_name_whose_second_part_is_taken_is_refused_at_the_start(
    tmp_path: Path, where: str
) -> None:
    (tmp_path / "stick").mkdir()
    old = tmp_path / where / "r_001.mcap"
    old.write_bytes(b"precious")
    output = DiskOutput(tmp_path / "r.mcap", settings(PartLimits(size_bytes=3000), old.parent))
    with pytest.raises(StreamError, match=r"r_001.mcap exists already; give .* another name"):
        output.start(head())
    assert sorted(tmp_path.rglob("*.mcap")) == [old]
    assert old.read_bytes() == b"precious"
    recorded(tmp_path / "r.mcap", NO_LIMITS)  # which needs no second part


def test_a_folder_that_takes_no_file_is_left_for_the_next(tmp_path: Path) -> None:
    """A disk that the system made read-only, say."""
    folders = tmp_path / "refuses", tmp_path / "stick"
    folders[1].mkdir()
    free = iter([10])
    output = DiskOutput(
        tmp_path / "r.mcap",
        settings(NO_LIMITS, *folders, reserve=6),
        free=lambda f: next(free, 10 * (f in folders)),
    )
    output.start(head())
    output.write(stamped(SAMPLES[:10]))
    output.tend()
    output.write(stamped(SAMPLES[10:]))
    assert "refuses/r_001.mcap: No such file" in " ".join(output.state().warnings)
    files = output.close()
    assert files == (tmp_path / "r.mcap", folders[1] / "r_001.mcap")
    assert len(content_of(files)) == len(SAMPLES)
