"""Cutting and merging: the right messages, unchanged, with everything that explains them."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

from acquisition.editing.cut_and_merge import CUT_METADATA_NAME, MERGE_METADATA_NAME, cut, merge
from acquisition.errors import StreamError
from acquisition.inspection import check
from acquisition.messages.frames import StaticTransforms
from acquisition.recovery.recover import recover
from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.parts import PART_NAME
from acquisition.stream.reader import StreamReader
from tests.fakes.damage import Told, content, replaced, unpacked
from tests.fakes.recordings import START_NS, clock_sample, pose, recording, samples

S = 1_000_000_000
DATA = recording(samples(1.0), chunk_size_bytes=4000)
SAID = unpacked(DATA)
STATIC = SAID[0]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "a.mcap"
    path.write_bytes(DATA)
    return path


def said(path: Path) -> list[Told]:
    return unpacked(path.read_bytes())


def metadata(path: Path) -> dict[str, dict[str, str]]:
    with path.open("rb") as file:
        return {r.name: r.metadata for r in make_reader(file).iter_metadata()}


def foreign(
    times_ns: list[int], topic: str = "/t", kind: str = "T", attachment: bytes = b"", **options: Any
) -> bytes:
    """Return a recording of another program whose messages hold their own time."""
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=100, **options)
    writer.start("other")
    channel = writer.register_channel(
        topic, "json", writer.register_schema(kind, "jsonschema", b"")
    )
    for t_ns in times_ns:
        writer.add_message(channel, t_ns, b"%d" % t_ns, t_ns)
    if attachment:
        writer.add_attachment(1, 2, "photo", "image/png", attachment)
    writer.finish()
    return stream.getvalue()


def written(folder: Path, *data: bytes) -> Iterator[Path]:
    for number, item in enumerate(data):
        path = folder / f"{'abc'[number]}.mcap"
        path.write_bytes(item)
        yield path


def test_a_cut_is_half_open_and_repeats_the_transforms(path: Path, tmp_path: Path) -> None:
    output = tmp_path / "cut.mcap"
    report = cut(path, output, start_s=0.25, end_s=0.5)
    start_ns = START_NS + S // 4
    inside = [m for m in SAID if start_ns <= m[2] < START_NS + S // 2]
    assert said(output) == [(*STATIC[:2], start_ns, *STATIC[3:]), *inside]
    assert report.messages["/mocap/pose"] == 25
    assert (report.start_ns, report.end_ns) == (start_ns, inside[-1][2])
    assert path.read_bytes() == DATA
    assert {"terravibe", CUT_METADATA_NAME} == set(metadata(output))
    assert metadata(output)[CUT_METADATA_NAME]["start_ns"] == str(start_ns)
    assert check(output) == []
    with FinishedFile(output) as file:
        first = next(iter(StreamReader(file)))
    assert isinstance(first.sample, StaticTransforms)


def test_absolute_and_relative_times_agree(path: Path, tmp_path: Path) -> None:
    one, other = tmp_path / "one.mcap", tmp_path / "other.mcap"
    cut(path, one, start_s=0.3, end_s=0.7)
    cut(path, other, start_ns=START_NS + 3 * S // 10, end_ns=START_NS + 7 * S // 10)
    assert said(one) == said(other)


def test_open_ends_reach_as_far_as_the_recording(path: Path, tmp_path: Path) -> None:
    output = tmp_path / "cut.mcap"
    cut(path, output)
    assert sorted(said(output)) == sorted(SAID)
    cut(path, output, start_s=-5.0, end_s=500.0)
    assert sorted(said(output)) == sorted(SAID)
    assert "363 messages, 1.000 s" in cut(path, output, start_s=0.0).describe()[0]


def test_topics_are_chosen_and_transforms_stay(path: Path, tmp_path: Path) -> None:
    output = tmp_path / "cut.mcap"
    report = cut(path, output, start_s=0.5, topics=["/mocap/pose"])
    assert report.messages == {"/mocap/pose": 50, "/tf_static": 1}
    with output.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert {c.topic for c in summary.channels.values()} == {"/mocap/pose", "/tf_static"}


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.integers(0, 100), min_size=1, max_size=40), st.integers(0, 101), st.integers(0, 101)
)
def test_a_cut_holds_what_lies_in_the_range(
    tmp_path_factory: pytest.TempPathFactory, times_ns: list[int], start_ns: int, end_ns: int
) -> None:
    folder = tmp_path_factory.mktemp("cut")
    (path,) = written(folder, foreign(times_ns))
    inside = sorted(t for t in times_ns if start_ns <= t < end_ns)
    output = folder / "out.mcap"
    try:
        cut(path, output, start_ns=start_ns, end_ns=end_ns)
    except StreamError:
        assert not inside
        assert not output.exists()
    else:
        assert [m[2] for m in said(output)] == inside


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"start_s": 2.0}, "nothing of .* lies in that range"),
        ({"end_s": 0.0}, "nothing of .* lies in that range"),
        ({"start_s": 0.5, "end_s": 0.4}, "nothing of .* lies in that range"),
        ({"start_s": 0.5, "start_ns": 5}, "give one of them"),
        ({"end_s": float("nan")}, "expected a number"),
        ({"topics": ["/none", "/mocap/pose"]}, "has no topic /none; it has /acceleration, "),
        ({"topics": ["/clock"], "start_ns": START_NS}, "no message"),
        # Nothing but transforms, which are repeated and were not asked for.
        ({"start_ns": START_NS + 1, "end_ns": START_NS + 2}, "no message"),
        ({"topics": ["/mocap/pose"], "start_s": 0.991}, "no message"),
    ],
)
def test_a_cut_that_gives_nothing_is_refused(
    options: dict[str, Any], reason: str, tmp_path: Path
) -> None:
    data = _without_transforms() if options.get("topics") == ["/clock"] else DATA
    (path,) = written(tmp_path, data)
    output = tmp_path / "cut.mcap"
    with pytest.raises(StreamError, match=reason):
        cut(path, output, **options)
    assert not output.exists()


def _without_transforms() -> bytes:
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    for topic in ("/acceleration", "/clock", "/mocap/pose"):
        number = writer.register_channel(topic, "json", 0)
        if topic != "/clock":
            writer.add_message(number, START_NS, b"{}", START_NS)
    writer.finish()
    return stream.getvalue()


def test_a_merge_is_in_order_of_log_time(tmp_path: Path) -> None:
    paths = list(written(tmp_path, foreign([1, 5, 5, 9]), foreign([2, 5, 8]), foreign([0, 10])))
    output = tmp_path / "all.mcap"
    seen: list[float] = []
    report = merge(paths, output, progress=seen.append)
    assert [m[2] for m in said(output)] == [0, 1, 2, 5, 5, 5, 8, 9, 10]
    assert report.messages == {"/t": 9}
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    with output.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert reader.get_header().profile == "other"
    assert summary is not None
    assert len(summary.channels) == 1
    inputs = json.loads(metadata(output)[MERGE_METADATA_NAME]["inputs"])
    assert [(i["file"], i["start_ns"], i["end_ns"], i["messages"]) for i in inputs] == [
        ("a.mcap", 1, 9, 4),
        ("b.mcap", 2, 8, 3),
        ("c.mcap", 0, 10, 2),
    ]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.lists(st.integers(0, 50), max_size=30), min_size=2, max_size=3))
def test_a_merge_holds_everything_once(
    tmp_path_factory: pytest.TempPathFactory, times_ns: list[list[int]]
) -> None:
    folder = tmp_path_factory.mktemp("merge")
    paths = list(written(folder, *map(foreign, times_ns)))
    merge(paths, folder / "all.mcap")
    assert [m[2] for m in said(folder / "all.mcap")] == sorted(chain(*times_ns))


def test_split_parts_merge_to_the_whole(path: Path, tmp_path: Path) -> None:
    parts = [tmp_path / f"part{i}.mcap" for i in range(3)]
    for number, part in enumerate(parts):
        cut(path, part, start_s=number / 3, end_s=(number + 1) / 3 if number < 2 else None)
    merge(parts, tmp_path / "whole.mcap")
    whole = [m for m in said(tmp_path / "whole.mcap") if m[0] != "/tf_static"]
    assert sorted(whole) == sorted(SAID[1:])
    assert [m[2] for m in whole] == sorted(m[2] for m in whole)


def test_hosts_and_boots_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("socket.gethostname", lambda: "rover")
    one = recording([clock_sample(0), pose(0)])
    monkeypatch.setattr("socket.gethostname", lambda: "tracker")
    other = recording([pose(1, START_NS + 5)]).replace(b"8d0f4c2e", b"00000000")
    paths = list(written(tmp_path, one, other))
    output = tmp_path / "all.mcap"
    report = merge(paths, output)
    (note,) = report.notes
    assert note.startswith("recorded by 2 hosts (rover, tracker): the log times are those of each")
    assert note in report.describe()
    records = metadata(output)
    assert json.loads(records[MERGE_METADATA_NAME]["notes"]) == [note]
    inputs = json.loads(records[MERGE_METADATA_NAME]["inputs"])
    assert [i["boot_id"] for i in inputs] == ["8d0f4c2e", ""]
    # Both recordings still say how they were made.
    assert records["terravibe"]["host"] == "rover"
    assert records["terravibe (b.mcap)"]["host"] == "tracker"
    assert report.messages["/tf_static"] == 2


def test_what_is_given_twice_is_told(path: Path, tmp_path: Path) -> None:
    output, copied = tmp_path / "all.mcap", tmp_path / "copied.mcap"
    copied.write_bytes(DATA)
    (note,) = merge([path, copied], output).notes
    assert note.startswith("363 messages are in several of the recordings, and now several times")
    assert json.loads(metadata(output)[MERGE_METADATA_NAME]["notes"]) == [note]
    assert len(said(output)) == 2 * 363
    for number, end_s in ((0, 0.5), (1, 0.6)):  # the second begins where the first ends, or before
        cut(path, tmp_path / "front.mcap", end_s=end_s)
        cut(path, tmp_path / "rest.mcap", start_s=0.5)
        report = merge([tmp_path / "front.mcap", tmp_path / "rest.mcap"], output)
        assert len(report.notes) == number


def part(number: int, folder: Path) -> Path:
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    writer.add_metadata(PART_NAME, {"recording": "ab", "part": str(number)})
    writer.add_message(writer.register_channel("/t", "json", 0), number, b"{}", number)
    writer.finish()
    (folder / "r").mkdir(exist_ok=True)
    (path,) = written(folder / "r", stream.getvalue())
    return path.rename(path.with_name(f"r_{number:03d}.mcap"))


def test_missing_parts_are_told_and_a_merge_of_parts_has_them(tmp_path: Path) -> None:
    first, second = tmp_path / "first.mcap", tmp_path / "second.mcap"
    parts = [part(number, tmp_path) for number in range(8)]
    told = "of recording ab these parts are missing: "
    assert merge(parts[5:2:-1], first).notes == ()
    assert merge([parts[1], first, parts[7]], second).notes == (told + "_002, _006",)
    assert merge([parts[0], parts[4]], second).notes == (told + "_001 to _003",)


def test_a_name_that_is_no_text_is_written_as_one(path: Path, tmp_path: Path) -> None:
    odd = path.rename(path.with_name(os.fsdecode(b"a\xff.mcap")))
    one, other, output = (tmp_path / f"{name}.mcap" for name in "123")
    cut(odd, one, end_s=0.5)
    recover(odd, other)
    assert metadata(one)[CUT_METADATA_NAME]["source"] == "a\\xff.mcap"
    merge([one, odd, other], output)
    assert "a\\\\xff.mcap" in metadata(output)[MERGE_METADATA_NAME]["inputs"]


def test_metadata_of_files_of_one_name_stay_apart(tmp_path: Path) -> None:
    paths: list[Path] = []
    for number in range(3):
        (tmp_path / str(number)).mkdir()
        paths += written(tmp_path / str(number), recording([pose(number, START_NS + number)]))
        paths[-1].write_bytes(paths[-1].read_bytes().replace(b"rate_hz", b"rate_h%d" % number))
    merge(paths, tmp_path / "all.mcap")
    kept = set(metadata(tmp_path / "all.mcap"))
    names = {"terravibe", "terravibe (a.mcap)", "terravibe (a.mcap, 2)"}
    assert kept == {*names, MERGE_METADATA_NAME}


def test_attachments_are_kept(tmp_path: Path) -> None:
    paths = list(
        written(tmp_path, foreign([1], attachment=b"one"), foreign([2], attachment=b"two"))
    )
    output = tmp_path / "all.mcap"
    merge(paths, output)
    cut(output, tmp_path / "cut.mcap", start_ns=2)
    with (tmp_path / "cut.mcap").open("rb") as file:
        assert [a.data for a in make_reader(file).iter_attachments()] == [b"one", b"two"]


@pytest.mark.parametrize(
    ("other", "reason"),
    [
        (foreign([1], kind="U"), "/t is T jsonschema json in one recording and U jsonschema json"),
        (DATA[:-1], "is damaged or has no proper end .*; recover it first"),
        (DATA[:3000], "is damaged or has no proper end .*; recover it first"),
        (b"PK" + DATA, "is damaged or has no proper end .*; recover it first"),
        (foreign([1], use_chunking=False), "has an incomplete index; recover it first"),
        (foreign([1], use_statistics=False), "has no index; recover it first"),
        (replaced(DATA, content(DATA)[3][0] + 200, bytes(40)), "recover it first"),
        (foreign([1], attachment=b"hello").replace(b"hello", b"hullo"), "attachment checksum"),
        (b"", "holds nothing; expected an MCAP recording"),
        (DATA[:5], "holds only 5 bytes; expected an MCAP recording"),
        (DATA[:8], "too short to have an end"),
        # A bit of the summary, by which every message would change its type.
        (replaced(DATA, DATA.rindex(b"/msg/Imu"), b"/msg/Ieu"), "checksum of the summary differs"),
        # The length of the first chunk's data.
        (replaced(DATA, content(DATA)[0][0] + 9 + 28 + 8 + 5, b"\x40"), "recover it first"),
    ],
)
def test_what_cannot_be_merged_is_refused(other: bytes, reason: str, tmp_path: Path) -> None:
    paths = list(written(tmp_path, foreign([1, 2]), other))
    with pytest.raises(StreamError, match=reason):
        merge(paths, tmp_path / "all.mcap")
    assert not (tmp_path / "all.mcap").exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap", "b.mcap"]


def test_names_are_checked(path: Path, tmp_path: Path) -> None:
    output = tmp_path / "all.mcap"
    with pytest.raises(StreamError, match="are the same file"):
        merge([path, path], output)
    with pytest.raises(StreamError, match="are the same file"):
        cut(path, path)
    with pytest.raises(StreamError, match="expected two or more"):
        merge([path], output)
    with pytest.raises(StreamError, match=r"cannot read .*none.mcap: No such file"):
        merge([path, tmp_path / "none.mcap"], output)
    with pytest.raises(StreamError, match=r"cannot read .*: Is a directory"):
        cut(tmp_path, output)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(StreamError, match=r"cannot read .*pipe: it is no ordinary file"):
        cut(tmp_path / "pipe", output)
