"""Products appear whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from acquisition.errors import StreamError
from acquisition.files import check_folder, refuse_same_file, replacing
from acquisition.stream.output import StreamOutput
from tests.acquisition.test_stream_writer import files_may_grow_to


def test_the_file_appears_when_it_is_complete(tmp_path: Path) -> None:
    target = tmp_path / "map.nc"
    target.write_text("old")
    with replacing(target) as temporary:
        assert (temporary.parent, temporary.suffix) == (tmp_path, ".nc")
        temporary.write_text("new")
        assert target.read_text() == "old"
    assert target.read_text() == "new"
    assert list(tmp_path.iterdir()) == [target]


def write_a_stream(path: Path) -> None:
    output = StreamOutput(path)
    try:
        output.write(bytes(100))
    finally:
        output.close()


def write_as_libraries_do(path: Path) -> None:
    path.write_bytes(bytes(100))


@pytest.mark.parametrize("write", [write_a_stream, write_as_libraries_do])
def test_a_full_disk_is_told_by_the_name_that_was_given(
    tmp_path: Path, write: Callable[[Path], None]
) -> None:
    target = tmp_path / "run.mcap"
    told = f"cannot write {target}: File too large; make room, or write to another disk"
    with (
        files_may_grow_to(50),
        pytest.raises(StreamError, match=f"^{told}$"),
        replacing(target) as temporary,
    ):
        write(temporary)
    assert list(tmp_path.iterdir()) == []


def test_no_error_tells_the_hidden_name(tmp_path: Path) -> None:
    target = tmp_path / "run"
    with pytest.raises(StreamError, match=r"^cannot write .*/run$"), replacing(target) as temporary:
        raise StreamError(f"cannot write {temporary}")


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_a_failure_leaves_the_old_file_alone(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "map.nc"
    target.write_text("old")

    def write_half() -> None:
        with replacing(target) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(error):
        write_half()
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_missing_folder_is_told_before_any_work(tmp_path: Path) -> None:
    with pytest.raises(StreamError, match="there is no folder"), replacing(tmp_path / "no" / "f"):
        pytest.fail("the body must not run")


def test_a_folder_is_no_target(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    with pytest.raises(StreamError, match="it is a folder"), replacing(tmp_path / "sub"):
        pytest.fail("the body must not run")


def test_what_is_no_file_is_no_target(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")  # as /dev/null, which root may replace
    with pytest.raises(StreamError, match="no ordinary file"), replacing(tmp_path / "pipe"):
        pytest.fail("the body must not run")


def test_a_folder_is_made_only_where_there_is_no_file(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    check_folder(tmp_path / "a" / "b")
    check_folder(tmp_path)
    for path in (tmp_path / "file", tmp_path / "file" / "a"):
        with pytest.raises(StreamError, match="is no folder"):
            check_folder(path)


def test_one_file_is_not_two(tmp_path: Path) -> None:
    (tmp_path / "run").touch()
    (tmp_path / "link").symlink_to(tmp_path / "run")
    refuse_same_file(tmp_path / "run", tmp_path / "map")
    for other in ("run", "link"):
        with pytest.raises(StreamError, match="the same file"):
            refuse_same_file(tmp_path / "run", tmp_path / other)


def test_a_folder_without_permission_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Tests may run as root, whom no permission stops.
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(StreamError, match="no permission"), replacing(tmp_path / "f"):
        pytest.fail("the body must not run")


def test_a_body_that_writes_nothing_is_told(tmp_path: Path) -> None:
    with (
        pytest.raises(StreamError, match="No such file"),
        replacing(tmp_path / "f"),
    ):
        pass
