"""Finding frames in damaged streams: nothing lost that could be proved, nothing invented."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drivers.vibration.frames import FrameParser
from drivers.vibration.profile import load_profile, shipped_profiles
from drivers.vibration.profile_tables import VibrationProfile
from tests.drivers.test_vibration_decode import CAPTURED_REPLY, MANUAL_FRAME
from tests.fakes.vibration_bytes import frame_of, random_frames, with_checksum
from tests.fakes.vibration_damage import damaged_stream, pieces


def _parsed(profile: VibrationProfile, *chunks: bytes) -> list[bytes]:
    parser = FrameParser(profile)
    return [frame.data for chunk in chunks for frame in parser.feed(chunk)]


def _without_ranges(profile: VibrationProfile) -> VibrationProfile:
    """Return the profile with fields that may hold anything: the hardest case."""
    fields = tuple(field.model_copy(update={"min": None, "max": None}) for field in profile.field)
    return profile.model_copy(update={"field": fields})


@pytest.mark.parametrize("name", shipped_profiles())
def test_a_hundred_thousand_frames_with_garbage_in_one_of_twenty(name: str) -> None:
    """See `DamagedStream` for what counts as undamaged.

    A checksum of 16 bits agrees with one damaged candidate in 65 536; benchmarks/serial_parser.py
    measures over many seeds what that comes to.
    """
    profile, rng = load_profile(name), random.Random(4)
    stream = damaged_stream(profile, random_frames(profile, rng, 100_000), rng)
    assert len(stream.undamaged) > 95_000
    parser = FrameParser(profile)
    delivered: list[bytes] = []
    for piece in pieces(stream.data, rng):
        for frame in parser.feed(piece):
            assert stream.data[frame.end - len(frame.data) : frame.end] == frame.data
            delivered.append(frame.data)
        assert parser.pending_bytes < 6 * profile.frame.shortest
    sent = iter(stream.intact)
    assert all(frame in sent for frame in delivered), "invented, repeated or out of order"
    assert stream.undamaged <= set(delivered)
    assert len(stream.intact) - len(delivered) < 60, "without a checksum, of 1000 doubtful ones"
    counters = parser.counters
    assert counters.frames == len(delivered)
    lost = len(stream.data) - len(delivered) * profile.frame.shortest
    assert counters.garbage_bytes == lost - parser.pending_bytes
    assert 4000 < counters.resyncs < 5500


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("kind", ["random", "hostile", "flips"])
@pytest.mark.parametrize("name", shipped_profiles())
def test_each_kind_of_damage(name: str, kind: str, seed: int) -> None:
    """Nothing lost or invented with a checksum; without one, nothing that could be known."""
    profile, rng = load_profile(name), random.Random(seed)
    stream = damaged_stream(profile, random_frames(profile, rng, 3000), rng, kind=kind)
    parser = FrameParser(profile)
    frames = [frame for piece in pieces(stream.data, rng) for frame in parser.feed(piece)]
    ends = [frame.end for frame in frames]
    assert ends == sorted(set(ends)), "repeated or out of order"
    assert {stream.intact[frame] for frame in stream.undamaged} <= set(ends)
    invented = {frame.data for frame in frames} - stream.intact.keys() - stream.decoys
    lost = set(stream.intact.values()) - set(ends)
    if profile.frame.checksum.kind is not None:
        assert (invented, lost) == (set(), set())
    elif kind == "random":
        assert invented == set()
        assert len(lost) <= 2
    else:
        # A part exchanged for the same part of another frame, or a bit that keeps the range.
        assert len(invented) <= (4 if kind == "hostile" else 50)
        assert len(lost) <= 12


@pytest.mark.parametrize("name", ["aft601d", "wtvb01-485", "wtvb01-485-fast"])
def test_changed_bytes_are_noticed_with_a_checksum(name: str) -> None:
    profile, rng = load_profile(name), random.Random(5)
    frames = random_frames(profile, rng, 2000)
    data = bytearray(b"".join(frames))
    hit = set(rng.sample(range(len(frames)), 200))
    for index in hit:
        data[index * len(frames[0]) + rng.randrange(len(frames[0]))] ^= rng.randint(1, 255)
    intact = [frame for index, frame in enumerate(frames) if index not in hit]
    assert _parsed(profile, bytes(data) + bytes(200)) == intact


def test_a_captured_reply_in_its_real_chunks() -> None:
    profile = load_profile("wtvb01-485")
    parser = FrameParser(profile)
    assert parser.feed(CAPTURED_REPLY[:32]) == []
    (frame,) = parser.feed(CAPTURED_REPLY[32:])
    assert frame.data == CAPTURED_REPLY
    assert frame.end == 51
    assert parser.counters.garbage_bytes == parser.pending_bytes == 0


@pytest.mark.parametrize("name", shipped_profiles())
@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32), longest=st.integers(1, 200))
def test_how_the_stream_is_cut_makes_no_difference(name: str, seed: int, longest: int) -> None:
    profile, rng = load_profile(name), random.Random(seed)
    stream = damaged_stream(profile, random_frames(profile, rng, 30), rng, share=0.4)
    whole, cut = FrameParser(profile), FrameParser(profile)
    expected = whole.feed(stream.data)
    assert [f for p in pieces(stream.data, rng, longest) for f in cut.feed(p)] == expected
    assert cut.counters == whole.counters


_CHUNKS = st.binary(max_size=80) | st.sampled_from(
    [load_profile(name).frame.sync for name in shipped_profiles()]
)


@pytest.mark.parametrize("name", shipped_profiles())
@settings(max_examples=250, deadline=None)
@given(data=st.lists(_CHUNKS, min_size=10, max_size=20))
@example(data=[b"\x55\x61" * 4000])
@example(data=[b"\x50\x03\x06" * 4000])
def test_any_bytes_do_no_harm(name: str, data: list[bytes]) -> None:
    """At least 10 000 byte strings over the shipped profiles."""
    profile = load_profile(name)
    parser = FrameParser(profile)
    for chunk in data:
        parser.feed(chunk)
        assert parser.pending_bytes < 6 * profile.frame.shortest


# --- without a checksum -------------------------------------------------------------------------


def test_a_frame_is_believed_when_the_next_one_begins() -> None:
    profile = load_profile("wtvb01-bt50")
    parser = FrameParser(profile)
    assert parser.feed(MANUAL_FRAME) == []
    assert parser.feed(MANUAL_FRAME[:1]) == []
    (frame,) = parser.feed(MANUAL_FRAME[1:2])
    assert (frame.data, frame.end) == (MANUAL_FRAME, 28)


def test_a_frame_that_lost_or_gained_bytes_is_not_delivered() -> None:
    profile = load_profile("wtvb01-bt50")
    frames = random_frames(profile, random.Random(6), 5)
    before, after = frames[0] + frames[1], frames[3] + frames[4]
    for damaged in (frames[2][:20], frames[2][5:], frames[2][:9] + b"\0\0\0" + frames[2][9:]):
        assert _parsed(profile, before + damaged + after)[:1] == frames[:1]
        assert frames[2] not in _parsed(profile, before + damaged + after)
        assert frames[3] in _parsed(profile, before + damaged + after)


def test_a_whole_frame_before_garbage_is_believed_unless_it_has_another_reading() -> None:
    profile = load_profile("wtvb01-bt50")
    first, second = random_frames(profile, random.Random(6), 2)
    noise = bytes.fromhex("8f 91 e7 d3 85")
    assert _parsed(profile, first + noise + second + first[:2]) == [first, second]
    # Without its noise the second of these is a frame that begins as the first one does.
    for cut in (8, 16, 22):
        doubtful = first[:cut] + noise[:2] + first[cut:] + second
        assert _parsed(profile, doubtful + first[:2]) == [second]
    # A successor with a broken sync has the length of one.
    assert _parsed(profile, first + b"\x54" + second[1:] + second * 2) == [first, second]


def test_a_whole_frame_before_much_garbage_is_not_waited_for() -> None:
    profile = load_profile("wtvb01-bt50")
    (first,) = random_frames(profile, random.Random(6), 1)
    parser = FrameParser(profile)
    assert parser.feed(first + b"\xf1" * 83) == []
    assert parser.pending_bytes == 28 + 83
    assert parser.feed(b"\xf1") == []
    assert (parser.pending_bytes, parser.counters.ambiguous) == (1, 1)


def test_a_stream_whose_payload_always_holds_the_sync_is_followed_once_it_is_found() -> None:
    """Even where no range helps: 55 61 stands at byte 16 of each frame from the third on."""
    profile = _without_ranges(load_profile("wtvb01-bt50"))
    start = random_frames(profile, random.Random(7), 3)
    hidden = [
        frame_of(profile, {"displacement": (0x6155, n, n), "temperature": (n,)}) for n in range(50)
    ]
    sent = start + hidden + random_frames(profile, random.Random(8), 4)
    assert _parsed(profile, b"".join(sent)) == sent[:-1]


def test_when_two_phases_are_equally_good_none_is_delivered() -> None:
    """Begun in the middle of such a stream, nothing says which 55 61 is the beginning."""
    profile = _without_ranges(load_profile("wtvb01-bt50"))
    hidden = [frame_of(profile, {"displacement": (0x6155, n, n)}) for n in range(50)]
    parser = FrameParser(profile)
    assert parser.feed(b"".join(hidden)[5:]) == []
    assert parser.counters.ambiguous > 80
    # As soon as the payload shows something else, the ambiguity ends.
    clear = random_frames(profile, random.Random(8), 6)
    delivered = [frame.data for frame in parser.feed(b"".join(clear))]
    assert len(delivered) >= len(clear) - 1
    assert delivered == (hidden + clear)[-1 - len(delivered) : -1]


def test_with_ranges_the_same_stream_is_clear_from_its_second_frame() -> None:
    profile = load_profile("wtvb01-bt50")
    raw = {"velocity": (3, 4, 5), "temperature": (2790,), "frequency": (37, 37, 37)}
    hidden = [frame_of(profile, raw | {"displacement": (0x6155, n, n)}) for n in range(50)]
    assert _parsed(profile, b"".join(hidden)[5:]) == hidden[1:-1]


# --- with a checksum ----------------------------------------------------------------------------


def test_a_correct_frame_inside_a_correct_frame_is_not_taken_out() -> None:
    profile = load_profile("wtvb01-485-fast")
    # A profile with long frames, in whose payload a whole short frame is hidden.
    frame = profile.frame.model_copy(update={"length": 40})
    long = profile.model_copy(update={"frame": frame})
    inner = frame_of(profile, {"displacement": (1, 2, 3)})
    outer = with_checksum(long, bytearray(b"\x50\x03\x06\x01\x02" + inner + bytes(24)))
    assert len(outer) == 40
    stream = outer * 5
    assert _parsed(long, stream + bytes(100)) == [outer] * 5
    assert _parsed(profile, stream + bytes(100)) == [inner] * 5


@pytest.mark.parametrize("name", ["aft601d", "wtvb01-485"])
def test_values_out_of_range_need_a_successor_or_silence(name: str) -> None:
    profile = load_profile(name)
    good = frame_of(profile, {"frequency": (370, 371, 372)})
    odd = frame_of(profile, {"frequency": (60000, 371, 372)})
    assert _parsed(profile, odd + good + odd + good) == [odd, good, odd, good]
    assert _parsed(profile, odd + b"?" + good) == [good]
    parser = FrameParser(profile)
    assert parser.feed(odd) == []
    assert [frame.data for frame in parser.end_burst()] == [odd]
    assert parser.feed(odd[:9]) == parser.end_burst() == []
    assert parser.pending_bytes == 0
    assert [frame.data for frame in parser.feed(good)] == [good]
    assert parser.counters.garbage_bytes == 9


def test_the_clock_tells_a_reply_from_other_bytes() -> None:
    profile = load_profile("wtvb01-485")
    late = bytearray(CAPTURED_REPLY)
    late[5] = 24  # the hour
    odd = with_checksum(profile, late)
    assert _parsed(profile, odd + CAPTURED_REPLY) == [odd, CAPTURED_REPLY]
    assert _parsed(profile, odd + b"?" + CAPTURED_REPLY) == [CAPTURED_REPLY]


def test_a_reply_with_the_sync_inside_waits_for_the_end_of_the_burst() -> None:
    """What stands inside may be the frame, and the reply garbage whose checksum agrees."""
    profile = load_profile("wtvb01-485")
    reply = frame_of(profile, {"displacement": (0x5003, 0x2E00, 0)})
    parser = FrameParser(profile)
    assert parser.feed(reply) == []
    assert [frame.data for frame in parser.end_burst()] == [reply]


@pytest.mark.parametrize("name", ["aft601d", "wtvb01-485", "wtvb01-485-fast"])
def test_a_frame_that_the_next_one_completes_does_not_swallow_it(name: str) -> None:
    """Its last byte was lost, and the first byte of the next frame is the same."""
    profile = load_profile(name)
    sync, rng = profile.frame.sync, random.Random(10)
    ending = next(
        f for f in iter(lambda: random_frames(profile, rng, 1)[0], b"") if f[-1] == sync[0]
    )
    following = random_frames(profile, rng, 1)[0]
    for stream in (ending[:-1] + following, ending + following):
        parser = FrameParser(profile)
        frames = parser.feed(stream + b"?")
        assert [frame.data for frame in frames] == [ending, following]
        assert [frame.end for frame in frames] == [len(ending), len(stream)]
        assert parser.end_burst() == []
        assert parser.counters.garbage_bytes == 1
        assert parser.counters.resyncs == 0


def test_a_truncated_frame_does_not_swallow_the_next_one() -> None:
    """The checksum of the truncated one is made to agree with bytes of the next frame."""
    profile = load_profile("wtvb01-485-fast")
    frames = random_frames(profile, random.Random(9), 3)
    # 50 03 06 p q + the first 6 bytes of the next frame: p and q solve the checksum.
    for pq in range(65536):
        false = b"\x50\x03\x06" + pq.to_bytes(2, "big") + frames[1][:6]
        if with_checksum(profile, bytearray(false)) == false:
            break
    else:
        pytest.fail("no such bytes")
    assert _parsed(profile, frames[0] + false[:5] + frames[1] + frames[2] + bytes(99)) == frames


def test_frames_that_tell_their_length(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "drivers/vibration/profiles/aft601d.toml").read_text()
    table = (
        '[frame.length_field]\noffset = 4\ntype = "uint8"\nbyte_order = "big"\n'
        "add = 7\nmin = 22\nmax = 60\n"
    )
    (tmp_path / "long.toml").write_text(text.replace("length = 22\n", f"\n{table}"))
    profile = load_profile(tmp_path / "long.toml")
    frames = []
    for length in (22, 30, 60, 25):
        frame = bytearray(length)
        frame[:5] = [0xAA, 0x55, length, 0, length - 7]
        frames.append(with_checksum(profile, frame))
    too_long = bytes([0xAA, 0x55, 0, 0, 54]) + bytes(56)
    stream = frames[0] + too_long + b"".join(frames[1:]) + b"\xaa\x55\0\0"
    assert _parsed(profile, *pieces(stream, random.Random(1), 7)) == frames
