"""Folders of depth images: what comes out, in which order, and what every defect is called."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from drivers.depth.files import MillimetrePngFolder, TumFolder
from drivers.depth.folder import POSE_SIGMA_M, POSE_SIGMA_RAD, DepthFolder
from drivers.depth.png import MillimetreTable
from drivers.errors import DriverError, EndOfSource
from drivers.samples import AccelerationSample, DepthFrame, PoseSample, Sample
from drivers.source import OpenSource, make_source
from tests.fakes.ordinary_user import ordinary_user

INTRINSICS_PX = (535.4, 539.2, 320.1, 247.6)
SIZE = (8, 6)


def write_png(path: Path, counts: np.ndarray) -> None:
    Image.fromarray(counts.astype(np.uint16)).save(path)


def image(index: int) -> np.ndarray:
    """Return counts that differ from frame to frame and from pixel to pixel."""
    return np.arange(SIZE[0] * SIZE[1]).reshape(SIZE[1], SIZE[0]) * 100 + index * 5000


@pytest.fixture
def tum(tmp_path: Path) -> Path:
    return make_tum(tmp_path / "tum")


def make_tum(folder: Path) -> Path:
    """Write three frames at 1.0, 1.5 and 2.0 s, poses around them, and accelerations."""
    (folder / "depth").mkdir(parents=True)
    stamps = ["1.0", "1.5", "2.0"]
    for index, stamp in enumerate(stamps):
        write_png(folder / "depth" / f"{stamp}.png", image(index))
    lines = "".join(f"{stamp} depth/{stamp}.png\n" for stamp in stamps)
    (folder / "depth.txt").write_text("# depth maps\n" + lines)
    (folder / "groundtruth.txt").write_text(
        "# poses\n1.0 0 0 1 0 0 0 1\n1.45 1 0 1 0 0 0 1\n1.55 2 0 1 0 0 0 1\n2.0 3 0 1 0 0 0 1\n"
    )
    (folder / "accelerometer.txt").write_text(
        "0.9 0 0 9.8\n1.0 0 0 9.7\n1.2 0 0 9.6\n1.9 0 0 9.5\n2.1 0 0 9.4\n"
    )
    return folder


@pytest.fixture
def millimetres(tmp_path: Path) -> Path:
    folder = tmp_path / "mm"
    folder.mkdir()
    return folder


def tum_source(folder: Path, **changes: Any) -> TumFolder:
    return TumFolder(folder, **{"intrinsics_px": INTRINSICS_PX, **changes})


def png_source(folder: Path, **changes: Any) -> MillimetrePngFolder:
    return MillimetrePngFolder(folder, **{"intrinsics_px": INTRINSICS_PX, **changes})


def play(source: DepthFolder) -> list[Sample]:
    """Open, read to the end, close."""
    samples: list[Sample] = []
    with OpenSource(source):
        while True:
            try:
                samples.extend(source.read(0.0))
            except EndOfSource:
                return samples


def frames(source: DepthFolder) -> list[DepthFrame]:
    return [sample for sample in play(source) if isinstance(sample, DepthFrame)]


def refusal(source: DepthFolder) -> str:
    """Return the one line with which `open` refuses; nothing is open afterwards."""
    with pytest.raises(DriverError) as caught:
        source.open()
    with pytest.raises(DriverError, match="not open"):
        source.read(0.0)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("depth: ")
    return str(caught.value)


def test_tum_samples_in_order(tum: Path) -> None:
    samples = play(tum_source(tum))
    assert [(type(sample).__name__[0], sample.t_ns // 10**8) for sample in samples] == [
        ("A", 9), ("A", 10), ("P", 10), ("D", 10),
        ("A", 12), ("P", 15), ("D", 15),
        ("A", 19), ("P", 20), ("D", 20), ("A", 21),
    ]  # fmt: skip
    assert [s.sequence for s in samples if isinstance(s, AccelerationSample)] == [0, 1, 2, 3, 4]


def test_tum_values(tum: Path) -> None:
    samples = play(tum_source(tum))
    depth = [sample for sample in samples if isinstance(sample, DepthFrame)]
    for index, frame in enumerate(depth):
        np.testing.assert_array_equal(frame.depth_mm, image(index) // 5)
        assert frame.depth_mm.dtype == np.uint16
        assert not frame.depth_mm.flags.writeable
        assert frame.sequence == index
    camera = depth[0].camera
    assert (camera.width_px, camera.height_px) == SIZE
    assert (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px) == INTRINSICS_PX
    poses = [sample for sample in samples if isinstance(sample, PoseSample)]
    np.testing.assert_allclose(np.stack([pose.position_m for pose in poses])[:, 0], [0.0, 1.5, 3.0])
    np.testing.assert_array_equal(poses[1].quat_wxyz, [1, 0, 0, 0])
    sigmas = [POSE_SIGMA_M] * 3 + [POSE_SIGMA_RAD] * 3
    np.testing.assert_allclose(poses[0].covariance, np.diag(np.square(sigmas)))
    assert not poses[0].covariance.flags.writeable
    acceleration = samples[0]
    assert isinstance(acceleration, AccelerationSample)
    np.testing.assert_array_equal(acceleration.acceleration_m_s2, [0, 0, 9.8])


def test_tum_info(tum: Path) -> None:
    info = tum_source(tum, name="cabinet").open()
    assert (info.name, info.model, info.time_base) == ("cabinet", "TUM RGB-D folder", "recorded")
    assert info.produces == (DepthFrame, PoseSample, AccelerationSample)
    assert info.nominal_rate_hz[DepthFrame] == pytest.approx(2.0)
    assert info.details["folder"] == "tum"
    assert info.details["DepthFrame"] == "3"
    assert info.details["counts_per_m"] == "5000"


def test_life_of_a_source(tum: Path) -> None:
    source = tum_source(tum)
    source.close()
    with pytest.raises(DriverError, match=r"depth is not open; call open\(\)"):
        source.read(0.0)
    assert len(frames(source)) == 3
    source.close()
    assert len(frames(source)) == 3  # opened again, from the start
    source.open()
    first = source.read(0.0)
    source.open()
    assert source.read(0.0)[-1].t_ns == first[-1].t_ns


def test_kinds_are_in_the_table(tum: Path, millimetres: Path) -> None:
    write_png(millimetres / "7.png", image(0))
    source = make_source("tum", folder=str(tum), intrinsics_px=list(INTRINSICS_PX))
    assert source.open().model == "TUM RGB-D folder"
    source = make_source("png", folder=millimetres, intrinsics_px=INTRINSICS_PX, rate_hz=30.0)
    assert source.open().model == "millimetre PNG folder"


def test_without_poses(tum: Path) -> None:
    (tum / "groundtruth.txt").unlink()
    assert "with_poses=False" in refusal(tum_source(tum))
    source = tum_source(tum, with_poses=False)
    assert PoseSample not in source.open().produces
    assert not any(isinstance(sample, PoseSample) for sample in play(source))


def test_frames_that_no_pose_covers(tum: Path) -> None:
    (tum / "groundtruth.txt").write_text("1.0 0 0 1 0 0 0 1\n1.05 0 0 1 0 0 0 1\n")
    message = refusal(tum_source(tum))
    assert "no pose for 2 of 3 frames" in message
    assert "first at 1.500000 s and the last at 2.000000 s" in message
    samples = play(tum_source(tum, frames_without_pose="keep"))
    assert [type(s) for s in samples if not isinstance(s, AccelerationSample)] == [
        PoseSample, DepthFrame, DepthFrame, DepthFrame,
    ]  # fmt: skip
    (tum / "groundtruth.txt").write_text("9.0 0 0 1 0 0 0 1\n")
    assert "no pose for 3 of 3" in refusal(tum_source(tum, frames_without_pose="keep"))


def test_gap_rule_can_be_set(tum: Path) -> None:
    assert "gaps up to 0.05 s" in refusal(tum_source(tum, max_pose_gap_s=0.05))
    assert len(frames(tum_source(tum, max_pose_gap_s=0.2))) == 3


def break_index(folder: Path, text: str) -> None:
    (folder / "depth.txt").write_text(text)


def other_image(folder: Path, image: Image.Image) -> None:
    image.save(folder / "depth" / "1.5.png")


def cut_image(folder: Path, size: int) -> None:
    path = folder / "depth" / "1.5.png"
    path.write_bytes(path.read_bytes()[:size])


def replace_by_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f: (f / "depth.txt").unlink(), r"cannot read .*depth.txt"),
        (lambda f: break_index(f, "# only\n"), r"depth.txt has no lines"),
        (lambda f: break_index(f, "1.0\n"), r"depth.txt:1: image '' is not there"),
        (lambda f: (f / "depth" / "1.5.png").unlink(), r"depth.txt:3: image 'depth/1.5.png'"),
        (lambda f: break_index(f, "2 depth/1.0.png\n1 depth/1.5.png"), r"depth.txt:2: stamp 1 "),
        (lambda f: other_image(f, Image.new("L", SIZE)), r"1.5.png has mode L; expected 16-bit"),
        (lambda f: other_image(f, Image.new("RGB", SIZE)), r"1.5.png has mode RGB"),
        (lambda f: other_image(f, Image.new("I;16", (8, 7))), r"1.5.png is 8x7 .* expected 8x6"),
        (lambda f: cut_image(f, 0), r"cannot read .*1.5.png"),
        (lambda f: cut_image(f, 20), r"cannot read .*1.5.png"),
        (lambda f: replace_by_folder(f / "accelerometer.txt"), r"cannot read .*accelerometer.txt"),
        (lambda f: (f / "accelerometer.txt").write_text("1 2 3\n"), r"accelerometer.txt:1: found"),
        (lambda f: (f / "groundtruth.txt").write_text("1 nan\n"), r"groundtruth.txt:1: found"),
    ],
)
def test_open_names_the_defect(tum: Path, damage: Callable[[Path], object], message: str) -> None:
    damage(tum)
    assert re.search(message, refusal(tum_source(tum)))


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
@pytest.mark.parametrize(
    "setting", ["depth_scale", "pose_sigma_m", "pose_sigma_rad", "max_pose_gap_s"]
)
def test_settings_must_be_positive(tum: Path, setting: str, value: float) -> None:
    assert f"{setting} is {value}; expected" in refusal(tum_source(tum, **{setting: value}))


@pytest.mark.parametrize(
    "intrinsics_px", [(0.0, 1, 1, 1), (1, -1, 1, 1), (1, 1, float("nan"), 1), (1, 1, 1)]
)
def test_intrinsics_must_make_sense(tum: Path, intrinsics_px: tuple[float, ...]) -> None:
    assert "intrinsics_px is" in refusal(tum_source(tum, intrinsics_px=intrinsics_px))


def test_other_settings_are_checked(tum: Path) -> None:
    assert "'ignore'" in refusal(tum_source(tum, frames_without_pose="ignore"))
    assert "is not a folder" in refusal(tum_source(tum / "absent"))


@pytest.mark.parametrize("forbidden", ["depth/1.5.png", "depth", "groundtruth.txt", "."])
def test_permissions_are_named(forbidden: str) -> None:
    with ordinary_user() as folder:
        tum = make_tum(folder / "tum")
        (tum / forbidden).chmod(0)
        assert "Permission denied" in refusal(tum_source(tum))
        (tum / forbidden).chmod(0o700)


def test_a_damaged_image_is_named_and_the_rest_still_plays(tum: Path) -> None:
    path = tum / "depth" / "1.5.png"
    path.write_bytes(path.read_bytes()[:70])  # the header is whole, the pixels are not
    source = tum_source(tum)
    with OpenSource(source):
        source.read(0.0)
        with pytest.raises(DriverError, match=r"depth: cannot read .*1.5.png: .*restore") as caught:
            source.read(0.0)
        assert "\n" not in str(caught.value)
        last = source.read(0.0)[-1]
        assert isinstance(last, DepthFrame)
        assert last.sequence == 2


def test_an_image_that_vanishes_after_open_is_named(tum: Path) -> None:
    source = tum_source(tum)
    with OpenSource(source):
        (tum / "depth" / "1.0.png").unlink()
        with pytest.raises(DriverError, match=r"cannot read .*1.0.png"):
            source.read(0.0)
        write_png(tum / "depth" / "1.5.png", np.zeros((2, 2)))
        with pytest.raises(DriverError, match=r"1.5.png is 2x2 pixels; expected 8x6"):
            source.read(0.0)


def test_impossible_depth_is_refused(tum: Path) -> None:
    source = tum_source(tum, depth_scale=10.0)
    with OpenSource(source), pytest.raises(DriverError, match=r"470 m; expected at most 65.535 m"):
        source.read(0.0)


@given(
    counts=st.lists(st.integers(0, 65535), min_size=1, max_size=20),
    scale=st.sampled_from([1000.0, 5000.0, 2000.0, 999.0, 1234.5]),
)
def test_conversion_rounds_half_to_even(counts: list[int], scale: float) -> None:
    array = np.array([counts], dtype=np.uint16)
    expected = [round(count * 1000 / scale) for count in counts]  # Python rounds half to even
    if max(expected) > 65535:
        with pytest.raises(DriverError, match="check the scale"):
            MillimetreTable(scale).convert(array, Path("a.png"))
    else:
        assert MillimetreTable(scale).convert(array, Path("a.png")).tolist() == [expected]


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=200
)
@given(position=st.integers(0, 200), replacement=st.binary(max_size=8))
def test_any_damage_to_a_png_is_a_driver_error(
    tum: Path, position: int, replacement: bytes
) -> None:
    path = tum / "depth" / "1.0.png"
    write_png(path, image(0))
    whole = path.read_bytes()
    path.write_bytes(whole[:position] + replacement + whole[position + len(replacement) :])
    source = tum_source(tum)
    try:
        source.open()
        source.read(0.0)
    except DriverError as error:
        assert "1.0.png" in str(error)  # noqa: PT017 - surviving the damage is as good
    source.close()


@pytest.mark.parametrize(
    ("names", "rate_hz", "t_ns"),
    [
        (["10.25", "9.5"], None, [9_500_000_000, 10_250_000_000]),
        (["1341841279510700000", "1341841278842700000"], None,
         [1341841278842700000, 1341841279510700000]),
        (["10", "9", "0012"], 30.0, [300_000_000, 333_333_333, 400_000_000]),
    ],
)  # fmt: skip
def test_png_names_are_times(
    millimetres: Path, names: list[str], rate_hz: float | None, t_ns: list[int]
) -> None:
    for name in names:
        write_png(millimetres / f"{name}.png", image(0))
    (millimetres / "notes.txt").write_text("not an image")
    found = frames(png_source(millimetres, rate_hz=rate_hz))
    assert [frame.t_ns for frame in found] == t_ns
    np.testing.assert_array_equal(found[0].depth_mm, image(0))
    assert [frame.sequence for frame in found] == ([0, 1, 3] if rate_hz else [0, 1])


def test_png_poses(millimetres: Path, tum: Path) -> None:
    write_png(millimetres / "1.5.png", image(0))
    source = png_source(millimetres, poses=tum / "groundtruth.txt")
    pose, frame = play(source)
    assert isinstance(pose, PoseSample)
    assert isinstance(frame, DepthFrame)
    np.testing.assert_allclose(pose.position_m, [1.5, 0, 1])
    write_png(millimetres / "2.5.png", image(1))
    assert "no pose for 1 of 2" in refusal(source)
    assert "cannot read" in refusal(png_source(millimetres, poses=tum / "absent.txt"))


@pytest.mark.parametrize(
    ("names", "rate_hz", "message"),
    [
        ([], None, "no .png files"),
        (["000001"], None, "000001.png is named by frame number; set rate_hz"),
        (["1.5"], 30.0, "1.5.png is not named by frame number but rate_hz is set"),
        (["1341841278842700000"], 30.0, "leave out rate_hz"),
        (["depth_1"], None, "depth_1.png: 'depth_1' is not a time"),
        (["1", "01"], 30.0, "have the same stamp"),
        (["1.5", "1.50"], None, "have the same stamp"),
        (["1"], 0.0, "rate_hz is 0.0; expected"),
    ],
)
def test_png_names_are_refused(
    millimetres: Path, names: list[str], rate_hz: float | None, message: str
) -> None:
    for name in names:
        write_png(millimetres / f"{name}.png", image(0))
    assert message in refusal(png_source(millimetres, rate_hz=rate_hz))


def test_real_cabinet(real_data: Path) -> None:
    samples = play(tum_source(real_data / "tum_fr3_cabinet"))
    assert len(samples) == 2 * 58
    pose, frame = samples[:2]
    assert isinstance(pose, PoseSample)
    assert isinstance(frame, DepthFrame)
    assert pose.t_ns == frame.t_ns == 1341841278842700000
    np.testing.assert_array_equal(pose.position_m, [-2.5508, 0.9872, 1.1019])
    np.testing.assert_allclose(pose.quat_wxyz, [0.2239, -0.4871, 0.7673, -0.3519], atol=1e-4)
    assert np.linalg.norm(pose.quat_wxyz) == pytest.approx(1.0, abs=1e-15)
    assert frame.depth_mm.shape == (480, 640)
    valid = frame.depth_mm[frame.depth_mm > 0]
    assert (valid.min(), valid.max()) == (875, 3178)
    assert valid.size / frame.depth_mm.size == pytest.approx(0.850, abs=0.001)
    assert all(a.t_ns <= b.t_ns for a, b in itertools.pairwise(samples))
