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
    assert (summary.info, summary.samples) == (SOURCE, len(content))
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


def test_a_missing_folder_is_told_and_the_source_closed(tmp_path: Path) -> None:
    source = FiniteSource(samples(0.1))
    with pytest.raises(StreamError, match="there is no folder"):
        record_all(source, tmp_path / "no" / "r.mcap", static_transforms=[], settings={})
    assert source.closed == 1


def test_a_disk_that_is_full_leaves_nothing_and_claims_nothing(tmp_path: Path) -> None:
    source = FiniteSource(samples(1.0))
    with (
        files_may_grow_to(len(recording(samples(1.0))) // 2),
        pytest.raises(StreamError, match=r"File too large$"),
    ):
        record_all(source, tmp_path / "r.mcap", static_transforms=[MOUNT], settings=SETTINGS)
    assert source.closed == 1
    assert not list(tmp_path.iterdir())
