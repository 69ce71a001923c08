"""Tiles on disk: every bit comes back, one writer, and what is damaged or foreign is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import zarr
from hypothesis import given
from hypothesis import strategies as st

from mapping.cells.cell_layers import CellLayers, empty_layers
from mapping.cells.grid import CellWindow
from mapping.errors import MappingError
from mapping.motion.run_state import fresh_run
from mapping.settings import MapSettings
from mapping.world import tile_store
from mapping.world.planes import from_planes, plane_names, to_planes
from mapping.world.tile_array import TileArray
from mapping.world.tile_store import TileStore
from mapping.world.tiles import TILE_CELLS, shares, tiles_of, window_of, without

ABOUT = {"settings": {"resolution_m": 0.05}}


def random_layers(rows: int, columns: int, seed: int = 1) -> CellLayers:
    """Return layers of random bits, apart from NaN."""
    random = np.random.default_rng(seed)
    layers = empty_layers(rows, columns)
    for layer in layers._asdict().values():
        bits = random.integers(0, 256, layer.nbytes, np.uint8).view(layer.dtype)
        if layer.dtype.kind == "f":
            bits = np.where(np.isnan(bits), layer.dtype.type(0.1), bits)
        layer[:] = bits.reshape(layer.shape)
    return layers


def same(a: CellLayers, b: CellLayers) -> bool:
    pairs = zip(a._asdict().values(), b._asdict().values(), strict=True)
    return all(x.tobytes() == y.tobytes() for x, y in pairs)


@given(st.integers(0, 10_000))
def test_planes_keep_every_bit_of_every_layer(seed: int) -> None:
    layers = random_layers(3, 5, seed)
    planes = to_planes(layers)
    assert planes.shape == (len(plane_names()), 3, 5)
    assert same(from_planes(planes), layers)


@pytest.mark.parametrize("stamp", [0, -1, 1, 2**63 - 1, -(2**63), 1_700_000_000_123_456_789])
def test_stamps_come_back(stamp: int) -> None:
    layers = empty_layers(1, 1)
    layers.last_ns[:] = stamp
    assert from_planes(to_planes(layers)).last_ns[0, 0] == stamp


def test_tiles_come_back_from_a_reopened_world(tmp_path: Path) -> None:
    path = tmp_path / "world.zarr"
    tiles = {
        tile: random_layers(TILE_CELLS, TILE_CELLS, seed)
        for seed, tile in enumerate([(0, 0), (-1, 0), (10**7, -(10**7))])
    }
    with TileStore.create(path, ABOUT) as store:
        store.save(tiles, fresh_run())
        store.save({(0, 0): tiles[-1, 0]}, fresh_run())
    tiles[0, 0] = tiles[-1, 0]
    with TileStore.reopen(path) as store:
        assert store.about["settings"] == ABOUT["settings"]
        assert store.tiles() == sorted(tiles)
        for tile, layers in tiles.items():
            assert same(store.read(tile), layers)
        assert not store.read((5, 5)).frames.any()


def test_one_writes_and_others_read(tmp_path: Path) -> None:
    path = tmp_path / "world.zarr"
    with TileStore.create(path, ABOUT) as store:
        with pytest.raises(MappingError, match="another process is writing to the world"):
            TileStore.reopen(path)
        with TileStore.read_only(path) as reader:
            store.save({(1, 2): random_layers(TILE_CELLS, TILE_CELLS)}, fresh_run())
            assert reader.tiles() == [(1, 2)]
    TileStore.reopen(path).close()


def test_a_world_is_not_overwritten(tmp_path: Path) -> None:
    TileStore.create(tmp_path / "w", ABOUT).close()
    with pytest.raises(MappingError, match="is not empty; give --continue to add"):
        TileStore.create(tmp_path / "w", ABOUT)


def test_what_is_no_world_is_refused(tmp_path: Path) -> None:
    for make in (TileStore.reopen, TileStore.read_only):
        with pytest.raises(MappingError, match="is no world map; give a folder made by"):
            make(tmp_path)
        with pytest.raises(MappingError, match=r"there is no world at .*/missing; check the name"):
            make(tmp_path / "missing")
    zarr.create_array(tmp_path / "other", shape=(3,), chunks=(3,), dtype="f8")
    with pytest.raises(MappingError, match="is no world map"):
        TileStore.read_only(tmp_path / "other")


def test_a_place_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(MappingError, match=r"cannot make the folder .*; give one that can be"):
        TileStore.create(tmp_path / "file" / "w", ABOUT)
    with pytest.raises(MappingError, match=r"/file is a file; a world is a folder: give another"):
        TileStore.create(tmp_path / "file", ABOUT)
    (tmp_path / "w" / "writer.lock").mkdir(parents=True)
    with pytest.raises(MappingError, match=r"cannot write to the world .* give a writable folder"):
        TileStore.create(tmp_path / "w", ABOUT)


def test_another_set_of_layers_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    TileStore.create(tmp_path / "w", ABOUT).close()
    monkeypatch.setattr(tile_store, "plane_names", lambda: ("elevation_m", "colour"))
    with pytest.raises(MappingError, match="was made by another version of terravibe"):
        TileStore.read_only(tmp_path / "w")


def test_a_missing_zarr_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr("importlib.import_module", missing)
    with pytest.raises(MappingError, match=r"run pip install 'terravibe\[world\]'"):
        TileStore.create(tmp_path / "w", ABOUT)


def test_a_world_without_motions_is_refused_by_its_format(tmp_path: Path) -> None:
    about = {"format": 1, "planes": plane_names(), "origin_cell": 2**35, **ABOUT}
    TileArray.make(tmp_path, {"terravibe_world": about})
    for make in (TileStore.reopen, TileStore.read_only):
        with pytest.raises(MappingError, match="has format 1, which lacks the rover's motions"):
            make(tmp_path)


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty"])
def test_a_damaged_tile_is_named(tmp_path: Path, damage: str) -> None:
    with TileStore.create(tmp_path / "w", ABOUT) as store:
        store.save({(0, 0): random_layers(TILE_CELLS, TILE_CELLS)}, fresh_run())
        (file,) = (tmp_path / "w" / "c").glob("0/*/*")
        content = file.read_bytes()
        middle = len(content) // 2
        flipped = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
        file.write_bytes({"cut": content[:-100], "flipped": flipped, "empty": b""}[damage])
        with pytest.raises(MappingError, match=f"{file} is damaged .*delete it to go on"):
            store.read((0, 0))


def test_a_tile_that_may_not_be_read_is_not_called_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    with TileStore.create(tmp_path / "w", ABOUT) as store:
        monkeypatch.setattr(zarr.Array, "__getitem__", forbidden)
        with pytest.raises(MappingError, match=r"cannot read .*: Permission denied; make it read"):
            store.read((0, 0))


def test_a_full_disk_is_said_and_the_old_tile_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old, new = (random_layers(TILE_CELLS, TILE_CELLS, seed) for seed in (1, 2))
    with TileStore.create(tmp_path / "w", ABOUT) as store:
        store.save({(0, 0): old}, fresh_run())

        def full(*_: object) -> None:
            raise OSError(28, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr(Path, "replace", full)
            with pytest.raises(MappingError, match="No space left on device; free some space"):
                store.save({(0, 0): new}, fresh_run())
        assert not list((tmp_path / "w").glob("staged.?/c"))
        assert same(store.read((0, 0)), old)


boxes = st.builds(
    CellWindow,
    st.integers(-400, 400),
    st.integers(-400, 400),
    st.integers(1, 300),
    st.integers(1, 300),
)


def _cells(window: CellWindow) -> set[tuple[int, int]]:
    return {
        (x, y)
        for x in range(window.first_x, window.first_x + window.cells_x)
        for y in range(window.first_y, window.first_y + window.cells_y)
    }


@given(boxes)
def test_the_shares_of_tiles_make_up_the_window(window: CellWindow) -> None:
    seen = np.zeros((window.cells_y, window.cells_x), int)
    for tile, inside, outside in shares(window):
        seen[outside] += 1
        whole = window_of(tile)
        assert inside[0].start + whole.first_y == outside[0].start + window.first_y
        assert inside[1].start + whole.first_x == outside[1].start + window.first_x
        assert 0 <= inside[0].start < inside[0].stop <= TILE_CELLS
        assert 0 <= inside[1].start < inside[1].stop <= TILE_CELLS
    assert (seen == 1).all()
    assert len(tiles_of(window)) == len(list(shares(window)))


@given(st.integers(-9, 9), st.integers(-9, 9), st.integers(-99, 99), st.integers(-99, 99))
def test_what_a_window_leaves_is_in_rectangles_that_do_not_overlap(
    dx: int, dy: int, x: int, y: int
) -> None:
    old, new = CellWindow(x, y, 7, 7), CellWindow(x + dx, y + dy, 7, 7)
    pieces = without(old, new)
    assert sum(piece.cells_x * piece.cells_y for piece in pieces) == len(_cells(old) - _cells(new))
    assert set().union(*map(_cells, pieces)) == _cells(old) - _cells(new)
    assert without(old, CellWindow(0, 0, 0, 0)) == [old]
    assert without(CellWindow(0, 0, 0, 0), old) == []


def test_settings_in_a_world_are_those_it_was_made_with(tmp_path: Path) -> None:
    settings = MapSettings(body_boxes_m=((0, 0, 0, 1, 1, 1),), resolution_m=0.03)
    from mapping.noise import KINECT_V1
    from mapping.world.world_map import about_world, check_continues, settings_of

    with TileStore.create(tmp_path / "w", about_world(settings, KINECT_V1)) as store:
        assert settings_of(store) == settings
        check_continues(store, settings)
        with pytest.raises(MappingError, match=r"has cells of 0\.03 m, the settings ask for 0\.04"):
            check_continues(store, MapSettings())


def test_a_disk_that_is_full_from_the_start_keeps_nothing_of_a_new_world(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole_make = TileArray.make

    def make(path: Path, attributes: dict[str, object]) -> None:
        if attributes:
            raise OSError(28, "No space left on device")
        whole_make(path, attributes)

    monkeypatch.setattr(TileArray, "make", make)
    with pytest.raises(MappingError, match=r"cannot make a world in .*: No space left on device;"):
        TileStore.create(tmp_path / "w", ABOUT)
    assert not list(tmp_path.iterdir())


def test_what_a_kill_left_of_making_a_world_does_not_stand_in_its_way(tmp_path: Path) -> None:
    TileStore.create(tmp_path / "w", ABOUT).close()
    (tmp_path / "w" / "zarr.json").unlink()  # the last that is written
    (tmp_path / "w" / ".run.0123.part.json").touch()
    with TileStore.create(tmp_path / "w", ABOUT) as store:
        assert store.tiles() == []
