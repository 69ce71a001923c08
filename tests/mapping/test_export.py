"""Exports, read back by other programs' libraries."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from PIL import Image

from mapping.cells.elevation_map import CellState
from mapping.errors import MappingError
from mapping.ground.layers import derive
from mapping.judging.evaluation import CONFIRMED
from mapping.output.export import export
from tests.mapping.maps import hilly_map, make_map

NAN = np.nan


def test_a_geotiff_has_bands_units_and_a_place(tmp_path: Path) -> None:
    map_ = hilly_map()
    export(map_, tmp_path / "map.tif")
    with rasterio.open(tmp_path / "map.tif") as file:
        measured = ("elevation", "sigma", "lower", "upper", "state")
        assert file.descriptions == (*measured, "slope", "roughness", "step", "traversability")
        assert file.units == ("m", "m", "m", "m", "1", "rad", "m", "m", "1")
        assert set(file.dtypes) == {"float32"}
        assert np.isnan(file.nodata)
        assert 'LOCAL_CS["terravibe terrain frame",UNIT["metre",1' in file.crs.wkt
        assert not file.crs.is_geographic
        assert file.tags()["ARRAYS_SHA256"] == map_.sha256()
        bands = file.read()
        for row, column in ((0, 0), (3, 7), (29, 39)):
            x, y = file.xy(29 - row, column)
            assert (x, y) == pytest.approx((map_.x_m[column], map_.y_m[row]))
    more = derive(map_)
    layers = (
        *(map_.elevation_m, map_.sigma_m, map_.lower_m, map_.upper_m, map_.state),
        *(more.slope_rad, more.roughness_m, more.step_m, more.traversability),
    )
    for band, layer in zip(bands, layers, strict=True):
        np.testing.assert_array_equal(band[::-1], layer)
    assert [entry.name for entry in tmp_path.iterdir()] == ["map.tif"]


def _read_ply(path: Path) -> tuple[list[str], NDArray[np.void], NDArray[np.int32]]:
    """Read what the header says, by the header: vertices of floats and bytes, triangles."""
    content = path.read_bytes()
    head, body = content.split(b"end_header\n", 1)
    header = head.decode("ascii").splitlines()
    assert header[:2] == ["ply", "format binary_little_endian 1.0"]
    counts = {line.split()[1]: int(line.split()[2]) for line in header if "element" in line}
    kinds = {"float": "<f4", "uchar": "u1"}
    properties = [line.split() for line in header if line.startswith("property")]
    vertex = np.dtype([(p[2], kinds[p[1]]) for p in properties if p[1] != "list"])
    vertices = np.frombuffer(body, vertex, counts["vertex"])
    face = np.dtype([("n", "u1"), ("v", "<i4", 3)])
    faces = np.frombuffer(body, face, counts["face"], offset=vertices.nbytes)
    assert len(body) == vertices.nbytes + faces.nbytes
    assert (faces["n"] == 3).all()
    return header, vertices, faces["v"]


def test_a_ply_holds_the_known_cells(tmp_path: Path) -> None:
    map_ = hilly_map()
    export(map_, tmp_path / "map.ply")
    header, vertices, faces = _read_ply(tmp_path / "map.ply")
    assert "property list uchar int vertex_indices" in header
    rows, columns = np.nonzero(map_.known)
    np.testing.assert_allclose(vertices["x"], map_.x_m[columns], rtol=1e-6)
    np.testing.assert_allclose(vertices["y"], map_.y_m[rows], rtol=1e-6)
    np.testing.assert_array_equal(vertices["z"], map_.elevation_m[map_.known])
    np.testing.assert_array_equal(vertices["sigma"], map_.sigma_m[map_.known])
    np.testing.assert_array_equal(vertices["state"], map_.state[map_.known])
    assert np.isin(vertices["state"][faces], CONFIRMED).all()


def test_every_triangle_faces_up_and_they_tile_the_map(tmp_path: Path) -> None:
    export(make_map(np.zeros((4, 6))), tmp_path / "map.ply")
    _, vertices, faces = _read_ply(tmp_path / "map.ply")
    corner = np.stack([vertices["x"], vertices["y"]], axis=-1)[faces].astype(float)
    side, other = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    areas = 0.5 * (side[:, 0] * other[:, 1] - side[:, 1] * other[:, 0])
    np.testing.assert_allclose(areas, 0.5 * 0.04**2, rtol=1e-4)
    assert areas.sum() == pytest.approx(3 * 5 * 0.04**2, rel=1e-4)


@pytest.mark.parametrize(
    ("heights", "faces"),
    [
        ([[0, 0], [0, 0]], {(0, 1, 3), (0, 3, 2)}),
        ([[NAN, 0], [0, 0]], {(0, 2, 1)}),
        ([[0, NAN], [0, 0]], {(0, 2, 1)}),
        ([[0, 0], [0, NAN]], {(0, 1, 2)}),
        ([[0, 0], [NAN, 0]], {(0, 1, 2)}),
        ([[0, NAN], [NAN, 0]], set()),
    ],
)
def test_three_known_corners_make_one_triangle(
    tmp_path: Path, heights: list[list[float]], faces: set[tuple[int, ...]]
) -> None:
    export(make_map(heights), tmp_path / "map.ply")
    found = _read_ply(tmp_path / "map.ply")[2]
    assert {tuple(face) for face in found.tolist()} == faces


def test_an_unconfirmed_cell_is_a_vertex_without_triangles(tmp_path: Path) -> None:
    state = [[2, 2, CellState.UNCONFIRMED], [3, 3, 2]]
    export(make_map(np.zeros((2, 3)), state=state), tmp_path / "map.ply")
    _, vertices, faces = _read_ply(tmp_path / "map.ply")
    assert vertices["state"].tolist() == [2, 2, 1, 3, 3, 2]
    assert 2 not in faces
    assert len(faces) == 3


def test_a_filled_cell_closes_the_mesh_and_says_so(tmp_path: Path) -> None:
    export(make_map(np.zeros((2, 2)), state=[[2, 2], [2, CellState.FILLED]]), tmp_path / "map.ply")
    _, vertices, faces = _read_ply(tmp_path / "map.ply")
    assert vertices["state"].tolist() == [2, 2, 2, CellState.FILLED]
    assert len(faces) == 2


def test_heights_can_be_recovered_from_the_png(tmp_path: Path) -> None:
    map_ = hilly_map()
    export(map_, tmp_path / "map.png")
    with Image.open(tmp_path / "map.png") as picture:
        assert picture.mode == "I;16"
        text = picture.info
        values = np.asarray(picture)[::-1]
    np.testing.assert_array_equal(values == 0, ~map_.known)
    assert values.max() == 65535
    scale_m, offset_m = float(text["height_scale_m"]), float(text["height_offset_m"])
    heights = offset_m + scale_m * values[map_.known].astype(float)
    assert np.abs(heights - map_.elevation_m[map_.known]).max() <= 0.5001 * scale_m
    assert "height_m = height_offset_m + height_scale_m * value" in text["Description"]
    assert float(text["first_y_m"]) == map_.y_m[-1]
    assert float(text["cell_size_m"]) == 0.04


@pytest.mark.parametrize("heights", [[[1.5, 1.5]], [[NAN, 2.0]]])
def test_a_flat_map_makes_a_png(tmp_path: Path, heights: list[list[float]]) -> None:
    export(make_map(heights), tmp_path / "map.png")
    with Image.open(tmp_path / "map.png") as picture:
        value, text = int(np.asarray(picture)[0, 1]), picture.info
    height = float(text["height_offset_m"]) + float(text["height_scale_m"]) * value
    assert height == pytest.approx(heights[0][1])


@pytest.mark.parametrize("suffix", ["tif", "tiff", "TIF", "ply", "png"])
def test_every_format_is_written_whole_or_not_at_all(tmp_path: Path, suffix: str) -> None:
    export(hilly_map(), tmp_path / f"map.{suffix}")
    assert [entry.name for entry in tmp_path.iterdir()] == [f"map.{suffix}"]
    with pytest.raises(MappingError, match="cannot write"):
        export(hilly_map(), tmp_path / "missing" / f"map.{suffix}")


@pytest.mark.parametrize("name", ["map.obj", "map", "map.npz"])
def test_an_unknown_format_is_refused_with_those_known(tmp_path: Path, name: str) -> None:
    with pytest.raises(MappingError, match=rf"{name}: .* ends in \.tif, \.tiff, \.ply, \.png"):
        export(hilly_map(), tmp_path / name)
