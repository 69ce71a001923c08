"""A real structured-light recording of a floor with a box, TUM RGB-D fr3/cabinet (CC BY 4.0)."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from acquisition.importing import record_all
from drivers.depth.files import TumFolder
from mapping.judging.floor_evaluation import Box, evaluate_floor, read_box
from mapping.session import MapOptions, MapResult, map_stream
from mapping.settings import MapSettings
from tests.fakes.recordings import reader_of
from tests.mapping.scenes import mount

# Of the depth camera that took fr3 (Sturm et al. 2012, calibration of the ASUS Xtion).
INTRINSICS_PX = (535.4, 539.2, 320.1, 247.6)
OPTIONS = MapOptions(
    MapSettings(resolution_m=0.03), mount_sigma_m=0.005, mount_sigma_rad=math.radians(0.5)
)


@pytest.fixture(scope="module")
def recording(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the folder as a recording."""
    source = TumFolder(
        real_data / "tum_fr3_cabinet",
        intrinsics_px=INTRINSICS_PX,
        pose_sigma_m=0.005,
        pose_sigma_rad=math.radians(0.3),
    )
    path = tmp_path_factory.mktemp("cabinet") / "cabinet.mcap"
    record_all(source, path, static_transforms=mount().transforms, settings={})
    return path.read_bytes()


@pytest.fixture(scope="module")
def result(recording: bytes) -> MapResult:
    return map_stream(reader_of(recording), OPTIONS)


@pytest.fixture(scope="module")
def box(real_data: Path) -> Box:
    return read_box(real_data / "tum_fr3_cabinet" / "box.txt")


def test_all_frames_are_mapped(result: MapResult) -> None:
    counts = result.counts
    assert (counts.frames, counts.frames_without_pose, counts.readings_outside) == (58, 0, 0)
    assert counts.readings > 15_000_000
    # Flying pixels, and cells on the box's edges that frames see from above or from its side.
    assert 0 < counts.rejected < 0.005 * counts.updates


@pytest.mark.parametrize("kind", ["measured", "around the box"])
def test_the_floor_is_flat_and_its_sigma_honest(result: MapResult, box: Box, kind: str) -> None:
    floor = evaluate_floor(result.map, 0.0, box).floor[kind]
    assert floor.cells > 1500
    assert abs(floor.median_m) <= 0.010
    assert floor.mad_sigma_m <= 0.006
    assert 0.60 <= floor.coverage_1sigma <= 0.80
    assert floor.coverage_3sigma >= 0.985


def test_the_far_floor_is_off_by_no_more_than_its_sigma_says(result: MapResult, box: Box) -> None:
    floor = evaluate_floor(result.map, 0.0, box).floor["confirmed"]
    assert floor.cells > 20_000
    assert floor.coverage_1sigma >= 0.60
    assert floor.coverage_3sigma >= 0.985


def test_the_top_of_the_box_is_where_it_was_measured(result: MapResult, box: Box) -> None:
    scores = evaluate_floor(result.map, 0.0, box)
    assert scores.box_cells > 100
    assert abs(scores.box_top_m - 0.554) <= 0.020


def test_the_recording_gives_the_same_bits_again(recording: bytes, result: MapResult) -> None:
    assert map_stream(reader_of(recording), OPTIONS).map.sha256() == result.map.sha256()
