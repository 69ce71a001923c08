from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.transform import Affine

from simulation.errors import SimulationError
from simulation.terrain.elevation_model import read_elevation_model

METRES = "+proj=eqc +R=1737400 +units=m"


def hills(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(-1800.0 + 3.0 * np.sin(x / 20.0) + 0.1 * y)


def write_geotiff(
    path: Path, crs: str | None = METRES, hole: bool = False, size: int = 60
) -> tuple[float, float]:
    """Write hills with 2 m pixels from (1000, 5000) up; return the centre."""
    x = 1001.0 + 2.0 * np.arange(size)
    y = 5001.0 + 2.0 * np.arange(size)
    heights = hills(*np.meshgrid(x, y))[::-1].astype(np.float32)
    if hole:
        heights[30, 30] = -9999.0
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=size,
        height=size,
        count=1,
        dtype="float32",
        crs=crs,
        transform=Affine(2.0, 0.0, 1000.0, 0.0, -2.0, 5000.0 + 2.0 * size),
        nodata=-9999.0,
    ) as file:
        file.write(heights, 1)
    return 1000.0 + size, 5000.0 + size


def test_a_geotiff_becomes_a_grid_around_its_centre(tmp_path: Path) -> None:
    x0, y0 = write_geotiff(tmp_path / "dem.tif")
    grid = read_elevation_model(tmp_path / "dem.tif", 20.0, 0.1)
    assert grid.extent == pytest.approx((-10.0, 10.0, -10.0, 10.0))
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    expected = hills(x0 + x, y0 + y) - hills(np.array(x0), np.array(y0))
    np.testing.assert_allclose(grid.height_m, expected, atol=2e-3)


def test_the_crop_lies_where_it_is_asked_for(tmp_path: Path) -> None:
    write_geotiff(tmp_path / "dem.tif")
    grid = read_elevation_model(tmp_path / "dem.tif", 8.0, 0.5, centre_m=(1030.0, 5080.0))
    expected = hills(np.array(1033.0), np.array(5078.0)) - hills(np.array(1030.0), np.array(5080.0))
    assert grid.height_at(3.0, -2.0) == pytest.approx(expected, abs=2e-3)


def test_a_geotiff_s_scale_and_offset_count(tmp_path: Path) -> None:
    write_geotiff(tmp_path / "dem.tif")
    plain = read_elevation_model(tmp_path / "dem.tif", 10.0, 0.5)
    with rasterio.open(tmp_path / "dem.tif", "r+") as file:
        file.scales, file.offsets = (0.5,), (100.0,)
    halved = read_elevation_model(tmp_path / "dem.tif", 10.0, 0.5)
    np.testing.assert_allclose(halved.height_m, 0.5 * plain.height_m, atol=1e-5)


def test_an_npz_has_its_corner_at_zero(tmp_path: Path) -> None:
    x, y = np.meshgrid(np.arange(30.0), np.arange(20.0))
    np.savez(tmp_path / "dem.npz", height_m=0.2 * x + 0.01 * y**2, spacing_m=1.0)
    grid = read_elevation_model(tmp_path / "dem.npz", 4.0, 0.25, centre_m=(10.0, 5.0))
    assert grid.height_at(1.0, 2.0) == pytest.approx(0.2 + 0.01 * (49.0 - 25.0), abs=1e-5)


def test_holes_outside_the_crop_do_not_matter(tmp_path: Path) -> None:
    write_geotiff(tmp_path / "dem.tif", hole=True)
    with pytest.raises(SimulationError, match="1 pixels of the crop"):
        read_elevation_model(tmp_path / "dem.tif", 10.0, 0.5)
    assert read_elevation_model(tmp_path / "dem.tif", 10.0, 0.5, (1030.0, 5030.0))


@pytest.mark.parametrize(("size", "centre"), [(200.0, None), (10.0, (1002.0, 5050.0))])
def test_a_crop_must_lie_inside(
    tmp_path: Path, size: float, centre: tuple[float, float] | None
) -> None:
    write_geotiff(tmp_path / "dem.tif")
    with pytest.raises(SimulationError, match="smaller crop or another centre"):
        read_elevation_model(tmp_path / "dem.tif", size, 0.5, centre)


def test_degrees_are_refused(tmp_path: Path) -> None:
    write_geotiff(tmp_path / "dem.tif", crs="+proj=longlat +R=1737400")
    with pytest.raises(SimulationError, match="not in metres"):
        read_elevation_model(tmp_path / "dem.tif", 10.0, 0.5)


@pytest.mark.parametrize("name", ["missing.tif", "missing.npz"])
def test_missing_files_are_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(SimulationError, match=name):
        read_elevation_model(tmp_path / name, 10.0, 0.5)


@pytest.mark.parametrize("name", ["text.tif", "text.npz"])
def test_files_of_another_kind_are_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("no elevation")
    with pytest.raises(SimulationError, match=name):
        read_elevation_model(tmp_path / name, 10.0, 0.5)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_an_image_without_a_place_is_refused(tmp_path: Path) -> None:
    with rasterio.open(
        tmp_path / "image.tif", "w", driver="GTiff", width=8, height=8, count=1, dtype="float32"
    ) as file:
        file.write(np.zeros((8, 8), np.float32), 1)
    with pytest.raises(SimulationError, match="not georeferenced"):
        read_elevation_model(tmp_path / "image.tif", 2.0, 0.5)


@pytest.mark.parametrize(
    ("heights", "spacing"),
    [
        (np.zeros(5), np.array(1.0)),
        (np.zeros((5, 5)), np.array(-1.0)),
        (np.zeros((5, 5)), np.zeros(2)),
        (np.array(["a", "b"]), np.array(1.0)),
    ],
)
def test_an_npz_without_a_raster_is_refused(
    tmp_path: Path, heights: NDArray[np.generic], spacing: NDArray[np.float64]
) -> None:
    np.savez(tmp_path / "dem.npz", height_m=heights, spacing_m=spacing)
    with pytest.raises(SimulationError, match=r"dem\.npz"):
        read_elevation_model(tmp_path / "dem.npz", 2.0, 0.5)


def test_an_npz_without_a_spacing_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "dem.npz", height_m=np.zeros((5, 5)))
    with pytest.raises(SimulationError, match="spacing_m"):
        read_elevation_model(tmp_path / "dem.npz", 2.0, 0.5)
