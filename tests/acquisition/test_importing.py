"""A finite source becomes a recording, or nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from acquisition.errors import StreamError
from acquisition.importing import record_all
from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.reader import StreamReader
from drivers.errors import DriverError, TerravibeError
from tests.acquisition.test_stream_writer import files_may_grow_to
from tests.fakes.finite_source import FiniteSource
from tests.fakes.recordings import (
    MOUNT,
    SETTINGS,
    SOURCE,
    fingerprint,
    reader_of,
    recording,
    samples,
)


def test_everything_is_recorded(tmp_path: Path) -> None:
    content = samples(0.3)
    source = FiniteSource(content)
    steps: list[int] = []
    summary = record_all(
        source,
        tmp_path / "r.mcap",
        static_transforms=[MOUNT],
        settings=SETTINGS,
        progress=steps.append,
    )
    assert (summary.info, sum(summary.samples.values())) == (SOURCE, len(content))
    stamps = [sample.t_ns for sample in content]
    said = summary.as_json()
    assert said["duration_s"] == (max(stamps) - min(stamps)) * 1e-9
    assert said["bytes"] == (tmp_path / "r.mcap").stat().st_size
    assert steps == sorted(steps)
    assert steps[-1] == len(content)
    assert (source.opened, source.closed) == (1, 1)
    with FinishedFile(tmp_path / "r.mcap") as file:
        assert fingerprint(StreamReader(file)) == fingerprint(reader_of(recording(content)))


@pytest.mark.parametrize(
    ("source", "error", "reason"),
    [
        (FiniteSource(samples(0.1), fails_after=4), DriverError, "unplugged"),
        (FiniteSource([]), StreamError, "holds no samples"),
    ],
)
def test_a_failure_leaves_no_file(
    tmp_path: Path, source: FiniteSource, error: type[TerravibeError], reason: str
) -> None:
    with pytest.raises(error, match=reason):
        record_all(source, tmp_path / "r.mcap", static_transforms=[], settings={})
    assert not list(tmp_path.iterdir())
    assert source.closed == 1


def test_a_full_disk_is_told_of_the_recording_and_leaves_nothing(tmp_path: Path) -> None:
    source, path = FiniteSource(samples(1.0)), tmp_path / "r.mcap"
    with (
        files_may_grow_to(2_000),
        pytest.raises(StreamError, match=r"write .*/r\.mcap: File too large; make room"),
    ):
        record_all(source, path, static_transforms=[], settings={})
    assert not list(tmp_path.iterdir())


def test_what_belongs_to_a_recording_may_keep_it_from_appearing(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    seen: list[bool] = []

    def refuse() -> None:
        raise DriverError("no truth")

    source = FiniteSource(samples(0.1))
    with pytest.raises(DriverError, match="no truth"):
        record_all(source, path, static_transforms=[], settings={}, when_complete=refuse)
    assert not list(tmp_path.iterdir())
    source = FiniteSource(samples(0.1))

    def note() -> None:
        seen.append(path.exists())

    record_all(source, path, static_transforms=[], settings={}, when_complete=note)
    assert (seen, path.exists()) == ([False], True)


def test_a_missing_folder_is_told_before_the_source_is_opened(tmp_path: Path) -> None:
    source = FiniteSource(samples(0.1))
    with pytest.raises(StreamError, match="there is no folder"):
        record_all(source, tmp_path / "no" / "r.mcap", static_transforms=[], settings={})
    assert source.opened == 0
