"""The ring: the last seconds, within a bound, on disk when something happens."""

from __future__ import annotations

import weakref
from pathlib import Path
from threading import Event

import pytest

from acquisition.errors import StreamError
from acquisition.recording.ring_output import RingOutput, RingSettings
from acquisition.stream.parts import parts_of, read_parts
from drivers.samples import Sample
from tests.acquisition.test_disk_output import head, stamped
from tests.fakes.recordings import samples

S = 1_000_000_000
MANY = samples(8.0)


def fill(ring: RingOutput, content: list[Sample], size: int = 20) -> None:
    for start in range(0, len(content), size):
        ring.write(stamped(content[start : start + size]))


def started(path: Path, settings: RingSettings) -> RingOutput:
    ring = RingOutput(path, settings)
    ring.start(head())
    return ring


def snapshot(path: Path) -> list[Sample]:
    found = [message.sample for message in read_parts(parts_of(path))]
    return [sample for sample in found if isinstance(sample, Sample)]


def test_a_trigger_writes_the_last_seconds_and_nothing_older(tmp_path: Path) -> None:
    ring = started(tmp_path / "r.mcap", RingSettings(2 * S, reserve_bytes=0))
    fill(ring, MANY)
    ring.trigger()
    ring.write([])
    files = ring.close()
    assert files == tuple(parts_of(tmp_path / "r_snap000.mcap"))
    found = snapshot(tmp_path / "r_snap000.mcap")
    end_ns = MANY[-1].t_ns
    assert [s.t_ns for s in found] == [s.t_ns for s in MANY if s.t_ns >= found[0].t_ns]
    assert 2.0 <= (end_ns - found[0].t_ns) / S <= 2.5


def test_nothing_is_written_without_a_trigger(tmp_path: Path) -> None:
    ring = started(tmp_path / "r.mcap", RingSettings(2 * S))
    fill(ring, MANY)
    assert ring.close() == ()
    assert not list(tmp_path.iterdir())


def test_snapshots_follow_each_other_without_gap_or_overlap(tmp_path: Path) -> None:
    ring = started(tmp_path / "r.mcap", RingSettings(8 * S, reserve_bytes=0))
    fill(ring, MANY[:500])
    ring.trigger()
    fill(ring, MANY[500:1000])
    ring.trigger()
    ring.write([])
    ring.close()
    together = snapshot(tmp_path / "r_snap000.mcap") + snapshot(tmp_path / "r_snap001.mcap")
    assert [s.t_ns for s in together] == [s.t_ns for s in MANY[:1000]]


def test_memory_is_bounded_and_a_shorter_ring_is_told(tmp_path: Path) -> None:
    limit_bytes = 240_000
    ring = started(tmp_path / "r.mcap", RingSettings(60 * S, limit_bytes, reserve_bytes=0))
    content = samples(16.0)
    for start in range(0, len(content), 10):
        ring.write(stamped(content[start : start + 10]))
        assert ring._store.size_bytes() <= limit_bytes
    assert ring.state().warnings == ("the ring is shorter than asked for: its memory is full",)
    assert ring.state().bytes_written > 1.5 * limit_bytes
    ring.trigger()
    ring.write([])
    ring.close()
    assert snapshot(tmp_path / "r_snap000.mcap")[-1].t_ns == content[-1].t_ns


class Parts(list[bytes]):
    """A list that tells when it is gone."""


def test_a_snapshot_that_failed_is_not_kept_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor does its error, whose traceback would keep it: each would take as much as the ring."""
    ring = RingOutput(tmp_path / "r.mcap", RingSettings(2 * S, reserve_bytes=S), free=lambda _: S)
    ring.start(head())
    parts = [Parts([b"compressed"]), Parts([b"more"])]
    kept = [weakref.ref(taken) for taken in parts]
    monkeypatch.setattr(ring._store, "take", parts.pop)
    for _ in range(2):
        ring.trigger()
        ring.write([])
        ring._snapshots.wait()
    assert [taken() for taken in kept] == [None, None]
    (warning,) = ring.state().warnings
    assert "2 snapshots not written, the last because: snapshot" in warning
    with pytest.raises(StreamError, match="not written"):
        ring.close()


def test_one_snapshot_is_written_at_a_time_and_none_forgotten(tmp_path: Path) -> None:
    """On a slow disk; one that was asked for just before the end is written as well."""
    released = Event()

    def free(_: Path) -> int:
        released.wait(10.0)
        return S

    ring = RingOutput(tmp_path / "r.mcap", RingSettings(8 * S, reserve_bytes=0), free=free)
    ring.start(head())
    for start in (0, 100, 200):
        fill(ring, MANY[start : start + 100])
        ring.trigger()
        ring.write([])
    assert not list(tmp_path.iterdir())
    fill(ring, MANY[300:400])
    released.set()
    files = ring.close()
    assert {file.name[:9] for file in files} == {"r_snap000", "r_snap001"}
    assert [s.t_ns for s in snapshot(tmp_path / "r_snap000.mcap")] == [s.t_ns for s in MANY[:100]]
    later = snapshot(tmp_path / "r_snap001.mcap")
    assert [s.t_ns for s in later] == [s.t_ns for s in MANY[100:400]]


def test_a_snapshot_that_does_not_fit_is_told_and_the_ring_goes_on(tmp_path: Path) -> None:
    settings = RingSettings(2 * S, reserve_bytes=10**9)
    ring = RingOutput(tmp_path / "r.mcap", settings, free=lambda _: 10**9)
    ring.start(head())
    fill(ring, MANY[:200])
    ring.trigger()
    fill(ring, MANY[200:])
    with pytest.raises(StreamError, match="not written: 1000 MB are free, the reserve is 1000"):
        ring.close()
    assert "not written" in ring.state().warnings[0]
    assert not list(tmp_path.iterdir())


def test_an_older_snapshot_is_not_overwritten(tmp_path: Path) -> None:
    """Nor is a new one lost to it: the numbers go on behind it."""
    old = tmp_path / "r_snap006_001.mcap"
    old.write_bytes(b"precious")
    (tmp_path / "r_snap.mcap").touch()
    ring = started(tmp_path / "r.mcap", RingSettings(2 * S, reserve_bytes=0))
    taken = tmp_path / "r_snap008.mcap"
    taken.write_bytes(b"by another program")
    for _ in range(2):
        fill(ring, MANY[:100])
        ring.trigger()
        ring.write([])
    with pytest.raises(StreamError, match="exists already"):
        ring.close()
    assert old.read_bytes() == b"precious"
    assert taken.read_bytes() == b"by another program"
    assert snapshot(tmp_path / "r_snap007.mcap")


def test_it_does_not_write_before_it_was_started(tmp_path: Path) -> None:
    ring = RingOutput(tmp_path / "r.mcap", RingSettings(S))
    with pytest.raises(StreamError, match="not started"):
        ring.write([])
    assert ring.close() == ()
