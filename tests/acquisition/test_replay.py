"""A recording as a device: the same samples, at the pace that is asked for."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import pytest

from acquisition.replay import Replay
from drivers.errors import DriverError, EndOfSource
from drivers.samples import AccelerationSample, DepthFrame, PoseSample, Sample
from tests.fakes.fake_time import FakeTime
from tests.fakes.recordings import START_NS, bits, pose, recording, samples

BEGIN_NS = 5_000


def replay(path: Path, fake: FakeTime, **options: Any) -> Replay:
    return Replay(path, clock_ns=fake, sleep=fake.sleep, **options)


def played(source: Replay, fake: FakeTime, timeout_s: float = 10.0) -> list[tuple[int, Sample]]:
    """Return each sample with the time at which it was given."""
    found: list[tuple[int, Sample]] = []
    while True:
        try:
            found += [(fake.now_ns, sample) for sample in source.read(timeout_s)]
        except EndOfSource:
            return found


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "r.mcap"
    file.write_bytes(recording(samples(0.5)))
    return file


def test_it_announces_what_the_recording_holds(path: Path) -> None:
    source = Replay(path, name="old")
    info = source.open()
    source.close()
    assert (info.name, info.model, info.time_base) == ("old", "replay", "recorded")
    assert set(info.produces) == {DepthFrame, PoseSample, AccelerationSample}


def test_at_real_speed_each_sample_comes_at_its_time(path: Path) -> None:
    fake = FakeTime(BEGIN_NS)
    source = replay(path, fake)
    source.open()
    found = played(source, fake)
    source.close()
    assert [bits(sample) for _, sample in found] == [bits(sample) for sample in samples(0.5)]
    for given_ns, sample in found:
        assert given_ns - BEGIN_NS == pytest.approx(sample.t_ns - START_NS, abs=100)


@pytest.mark.parametrize(("speed", "share"), [(2.0, 0.5), (0.25, 4.0), (0.0, 0.0)])
def test_it_plays_at_any_speed(path: Path, speed: float, share: float) -> None:
    fake = FakeTime(BEGIN_NS)
    source = replay(path, fake, speed=speed)
    source.open()
    assert len(played(source, fake)) == len(samples(0.5))
    source.close()
    recorded_ns = samples(0.5)[-1].t_ns - START_NS
    assert fake.now_ns - BEGIN_NS == pytest.approx(share * recorded_ns, abs=1000)


def test_a_read_waits_no_longer_than_it_may(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    path.write_bytes(recording([pose(0), pose(1, START_NS + 10**9)]))
    fake = FakeTime(BEGIN_NS)
    source = replay(path, fake)
    source.open()
    assert len(source.read(0.3)) == 1
    assert [len(source.read(0.3)) for _ in range(4)] == [0, 0, 0, 1]
    assert fake.slept_s == pytest.approx([0.3, 0.3, 0.3, 0.1])
    source.close()


def test_repeats_keep_time_and_numbers_rising(path: Path) -> None:
    fake = FakeTime(BEGIN_NS)
    source = replay(path, fake, speed=0.0, repeats=3)
    source.open()
    found = [sample for _, sample in played(source, fake)]
    source.close()
    once = samples(0.5)
    assert len(found) == 3 * len(once)
    assert [bits(sample) for sample in found[: len(once)]] == [bits(sample) for sample in once]
    poses = [sample for sample in found if isinstance(sample, PoseSample)]
    assert [sample.sequence for sample in poses] == list(range(len(poses)))
    steps = {b.t_ns - a.t_ns for a, b in itertools.pairwise(poses)}
    assert min(steps) > 0
    assert max(steps) < 200_000_000


def test_it_may_be_opened_again_and_closed_twice(path: Path) -> None:
    fake = FakeTime(BEGIN_NS)
    source = replay(path, fake, speed=0.0)
    for _ in range(2):
        source.open()
        first = source.read(1.0)[0]
        assert bits(first) == bits(samples(0.5)[0])
        source.close()
        source.close()
    with pytest.raises(DriverError, match="not open"):
        source.read(0.0)


def damaged(data: bytes) -> bytes:
    changed = bytearray(data)
    changed[len(data) // 2] ^= 1
    return bytes(changed)


def test_damage_is_an_error(path: Path) -> None:
    path.write_bytes(damaged(path.read_bytes()))
    fake = FakeTime(BEGIN_NS)
    source = replay(path, fake, speed=0.0)
    source.open()
    with pytest.raises(DriverError, match=r"replay: .*r.mcap is damaged: .* at offset"):
        played(source, fake)
    source.close()


def test_a_recording_too_disordered_is_an_error(path: Path) -> None:
    times_ns = [0, 10**9, 2 * 10**9, 1]
    path.write_bytes(recording([pose(i, START_NS + t_ns) for i, t_ns in enumerate(times_ns)]))
    fake = FakeTime(BEGIN_NS)
    source = replay(path, fake, speed=0.0)
    source.open()
    with pytest.raises(DriverError, match="1 messages too late"):
        played(source, fake)
    source.close()


@pytest.mark.parametrize(
    ("data", "reason"),
    [(b"", "index"), (b"nonsense", "index"), (recording([pose(0)])[:-30], "index")],
)
def test_a_recording_without_index_is_an_error(path: Path, data: bytes, reason: str) -> None:
    path.write_bytes(data)
    with pytest.raises(DriverError, match=reason):
        Replay(path).open()


def test_a_missing_recording_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match="No such file"):
        Replay(tmp_path / "no.mcap").open()


@pytest.mark.parametrize("options", [{"speed": -1.0}, {"speed": float("nan")}, {"repeats": 0}])
def test_settings_that_make_no_sense_are_refused(path: Path, options: Any) -> None:
    with pytest.raises(DriverError, match="expected speed >= 0"):
        Replay(path, **options)


def test_samples_are_frozen(path: Path) -> None:
    source = Replay(path, speed=0.0)
    source.open()
    (sample,) = source.read(0.0)
    source.close()
    with pytest.raises(dataclasses.FrozenInstanceError):
        sample.t_ns = 0  # type: ignore[misc]  # that it fails is the point
