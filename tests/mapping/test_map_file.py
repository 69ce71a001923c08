"""The map file: bit for bit there and back, readable by others, honest about damage."""

from __future__ import annotations

import resource
import signal
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.cells.elevation_map import CellState
from mapping.errors import MappingError
from mapping.ground.fusion import fuse_map
from mapping.ground.layers import LayerSettings, derive
from mapping.output.map_file import read_map, write_map
from tests.fakes.ordinary_user import ordinary_user
from tests.mapping.maps import EPOCH_NS, hilly_map, make_map


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "map.nc"


@pytest.fixture(scope="module")
def hilly_bytes(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("hilly") / "map.nc"
    write_map(hilly_map(), path)
    return path.read_bytes()


@pytest.fixture
def hilly_file(path: Path, hilly_bytes: bytes) -> Path:
    """Return a file of `hilly_map`, to do with as one likes."""
    path.write_bytes(hilly_bytes)
    return path


def test_a_map_comes_back_bit_for_bit(path: Path) -> None:
    map_ = hilly_map()
    write_map(map_, path)
    again = read_map(path)
    assert again.sha256() == map_.sha256()
    assert again.attributes == map_.attributes
    assert [type(value) for value in again.attributes.values()] == [
        type(value) for value in map_.attributes.values()
    ]
    assert again.resolution_m == map_.resolution_m
    for item in fields(map_):
        if isinstance(value := getattr(map_, item.name), np.ndarray):
            assert getattr(again, item.name).dtype == value.dtype


def test_every_bit_pattern_survives(path: Path) -> None:
    """Every sign and exponent with four fractions, NaN payloads among them; stamps of any size."""
    fractions = np.array([0, 0x400001, 0x6AAAAA, 0x7FFFFF], np.uint32)  # no NaN that signals
    bits = (np.arange(512, dtype=np.uint32) << 23)[:, np.newaxis] | fractions
    map_ = make_map(np.zeros(bits.shape), state=CellState.UNKNOWN)  # no layers of such heights
    random = np.random.default_rng(1)
    stamps_ns = random.integers(-(2**63), 2**63, bits.shape, dtype=np.int64)
    stamps_ns[0] = [-(2**63), -1, 0, 2**63 - 1]
    map_ = replace(map_, elevation_m=bits.view(np.float32), last_seen_ns=stamps_ns)
    write_map(map_, path)
    assert read_map(path).sha256() == map_.sha256()


def test_equal_maps_make_equal_files(tmp_path: Path) -> None:
    write_map(hilly_map(), tmp_path / "a.nc")
    write_map(hilly_map(), tmp_path / "b.nc")
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()


def test_a_plain_reader_sees_conventional_names_units_and_flags(hilly_file: Path) -> None:
    map_ = hilly_map()
    with xr.open_dataset(hilly_file) as dataset:
        assert dataset.attrs["Conventions"] == "CF-1.11"
        assert dataset.attrs["arrays_sha256"] == map_.sha256()
        assert dataset.attrs["map_noise_model"] == "nguyen2012"
        assert dataset.attrs["map_confirmations"] == 3
        assert "z up" in dataset.attrs["frame"]
        assert dataset["elevation"].dims == ("y", "x")
        assert [dataset[a].attrs["axis"] for a in "xy"] == ["X", "Y"]
        for variable in dataset.variables.values():
            assert variable.attrs["units"]
            assert variable.attrs["long_name"]
        state = dataset["state"].attrs
        assert list(state["flag_values"]) == [0, 1, 2, 3, 4, 5]
        assert state["flag_meanings"] == "unknown unconfirmed measured uncertain filled occluded"
        assert dataset["time"].dtype == np.int64
        assert dataset["time"].values.max() == EPOCH_NS
        np.testing.assert_array_equal(dataset["upper"].values, map_.upper_m)
        np.testing.assert_array_equal(dataset["lower"].values, map_.lower_m)
        by_place = dataset["elevation"].sel(x=-0.02, y=0.3, method="nearest").item()
    assert by_place == pytest.approx(float(map_.elevation_m[2, 2]), nan_ok=True)


def test_derived_layers_stand_beside_the_map_with_how_they_were_made(hilly_file: Path) -> None:
    map_ = hilly_map()
    layers, fused = derive(map_), fuse_map(map_)
    with xr.open_dataset(hilly_file) as dataset:
        for name, layer in (
            ("slope", layers.slope_rad),
            ("slope_sigma", layers.slope_sigma_rad),
            ("normal_x", layers.normal_x),
            ("normal_y", layers.normal_y),
            ("roughness", layers.roughness_m),
            ("roughness_noise", layers.roughness_noise_m),
            ("step", layers.step_m),
            ("traversability", layers.traversability),
            ("fused_elevation", fused.elevation_m),
            ("fused_variance", fused.variance_m2),
            ("fused_lower", fused.lower_m),
            ("fused_upper", fused.upper_m),
        ):
            np.testing.assert_array_equal(dataset[name].values, layer)
        for name, value in asdict(LayerSettings()).items():
            assert dataset.attrs[f"layer_{name}"] == value


def test_a_file_from_before_the_derived_layers_is_read(hilly_file: Path) -> None:
    map_ = hilly_map()
    with xr.open_dataset(hilly_file) as dataset:
        old = dataset.load().drop_vars(
            [
                *("slope", "slope_sigma", "normal_x", "normal_y"),
                *("roughness", "roughness_noise", "step", "traversability"),
                *("fused_elevation", "fused_variance", "fused_lower", "fused_upper"),
            ]
        )
    old.to_netcdf(hilly_file, engine="h5netcdf")
    assert read_map(hilly_file).sha256() == map_.sha256()


def test_layers_are_compressed(path: Path) -> None:
    write_map(make_map(np.zeros((300, 300))), path)
    assert path.stat().st_size < 300 * 300 * 4


def test_a_file_that_another_program_rewrote_is_read(hilly_file: Path) -> None:
    map_ = hilly_map()
    with xr.open_dataset(hilly_file) as dataset:
        rewritten = dataset.load()
    rewritten["mine"] = rewritten["elevation"] * 0
    rewritten.to_netcdf(hilly_file, engine="h5netcdf")
    assert read_map(hilly_file).sha256() == map_.sha256()


def test_a_rewritten_file_with_other_heights_is_refused(hilly_file: Path) -> None:
    with xr.open_dataset(hilly_file) as dataset:
        changed = dataset.load()
    changed["elevation"] = changed["elevation"] + np.float32(0.001)
    changed.to_netcdf(hilly_file, engine="h5netcdf")
    with pytest.raises(MappingError, match="damaged"):
        read_map(hilly_file)


@pytest.fixture(scope="module")
def small_file(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the bytes of a map of 4 x 5 cells."""
    path = tmp_path_factory.mktemp("small") / "map.nc"
    write_map(make_map(np.zeros((4, 5))), path)
    return path.read_bytes()


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_any_flipped_byte_is_noticed(
    small_file: bytes, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    content = bytearray(small_file)
    # Inside the seal's mark the seal itself is gone; the arrays' own sum then vouches for them.
    place = data.draw(st.integers(8, len(content) - 83))
    content[place] ^= data.draw(st.integers(1, 255))
    path = tmp_path_factory.mktemp("flip") / "map.nc"
    path.write_bytes(content)
    with pytest.raises(MappingError, match="damaged"):
        read_map(path)


@pytest.mark.parametrize("kept", [0.2, 0.6, 0.99])
def test_a_cut_file_is_refused(hilly_file: Path, kept: float) -> None:
    content = hilly_file.read_bytes()
    hilly_file.write_bytes(content[: int(kept * len(content))])
    with pytest.raises(MappingError, match="damaged"):
        read_map(hilly_file)


@pytest.mark.parametrize("content", [b"", b"x y z\n1 2 3\n", b"\x89HDF"])
def test_another_kind_of_file_is_refused(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(MappingError, match=r"map\.nc is not a NetCDF-4 file; give a file"):
        read_map(path)


def test_a_netcdf_file_without_our_layers_is_refused(path: Path) -> None:
    xr.Dataset({"elevation": ("y", [1.0])}).to_netcdf(path, engine="h5netcdf")
    with pytest.raises(MappingError, match=r"no terravibe map: it has no count, .* and 14 more"):
        read_map(path)


def test_a_missing_file_and_a_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(MappingError, match=r"cannot read .*nowhere\.nc: No such file"):
        read_map(tmp_path / "nowhere.nc")
    with pytest.raises(MappingError, match="Is a directory"):
        read_map(tmp_path)


def test_a_map_is_not_written_into_a_missing_folder_or_over_a_folder(tmp_path: Path) -> None:
    with pytest.raises(MappingError, match=r"there is no folder .*; create it first"):
        write_map(hilly_map(), tmp_path / "no" / "map.nc")
    with pytest.raises(MappingError, match="it is a folder"):
        write_map(hilly_map(), tmp_path)
    with pytest.raises(MappingError, match="cannot write"):
        write_map(hilly_map(), Path())
    assert not list(tmp_path.iterdir())


def test_a_folder_without_permission_is_named(path: Path) -> None:
    write_map(hilly_map(), path)  # loads libraries that an ordinary user may not be let read
    with ordinary_user() as folder:
        folder.chmod(0o500)
        with pytest.raises(MappingError, match=r"cannot write .*map\.nc: Permission denied; give"):
            write_map(hilly_map(), folder / "map.nc")
        folder.chmod(0o700)


def test_a_full_disk_leaves_the_old_map_and_no_remains(path: Path) -> None:
    write_map(make_map([[1.0]]), path)
    old = path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    assert signal.getsignal(signal.SIGXFSZ) == signal.SIG_IGN  # Python's own choice
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
        with pytest.raises(MappingError, match=r"write .*map\.nc: File too large; make room"):
            write_map(hilly_map(), path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == old
    assert [entry.name for entry in path.parent.iterdir()] == ["map.nc"]


@pytest.mark.parametrize("value", ["a\0b", 2**70, "\udcff"])
def test_an_attribute_that_cannot_be_stored_is_refused(path: Path, value: str | int) -> None:
    map_ = replace(hilly_map(), attributes={"input": value})
    with pytest.raises(MappingError, match=r"cannot write .*; attributes must be plain text"):
        write_map(map_, path)
    assert not path.exists()


def test_text_attributes_survive(path: Path) -> None:
    attributes: dict[str, str | float] = {
        "empty": "",
        "lines": "a\nb",
        "accent": "café μ",
        "resolution_m": 0.1,
    }
    write_map(replace(hilly_map(), attributes=attributes), path)
    assert read_map(path).attributes == attributes
