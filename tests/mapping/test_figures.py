"""Figures: what they show, and that every map however small can be drawn."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import art3d
from numpy.typing import NDArray
from PIL import Image

from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.errors import MappingError
from mapping.output import figures
from mapping.output.figure_errors import consistency_figure, error_figure
from mapping.output.figure_layers import layers_figure
from mapping.output.figure_plan import central_range, height_figure, sigma_figure, state_figure
from mapping.output.figure_profile import Section, longest_section, profile_figure
from mapping.output.figure_surface import surface_figure
from mapping.output.figures import png_bytes, write_figures
from tests.mapping.maps import hilly_map, make_map

NAMES = ["height", "sigma", "state", "layers", "fused", "profile", "surface"]


def _truth(map_: ElevationMap) -> NDArray[np.float64]:
    return np.nan_to_num(map_.elevation_m.astype(np.float64)) + 0.002


def _words(figure: Figure) -> str:
    axes = figure.axes
    return " | ".join(
        word for a in axes for word in (a.get_title(), a.get_xlabel(), a.get_ylabel())
    )


def test_all_figures_are_written_as_pictures(tmp_path: Path) -> None:
    map_ = hilly_map()
    before = dict(mpl.rcParams)
    paths = write_figures(map_, tmp_path / "new" / "figures", _truth(map_))
    assert [path.stem for path in paths] == [*NAMES, "error", "consistency"]
    assert sorted(path.name for path in (tmp_path / "new" / "figures").iterdir()) == sorted(
        path.name for path in paths
    )
    for path in paths:
        with Image.open(path) as picture:
            assert min(picture.size) > 300
            assert len(set(picture.convert("L").tobytes())) > 20  # not an empty sheet
    assert dict(mpl.rcParams) == before
    assert not plt.get_fignums()


def test_without_a_truth_there_are_no_errors_to_show(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures, "png_bytes", lambda figure: b"")  # the names are the point
    assert [path.stem for path in write_figures(hilly_map(), tmp_path)] == NAMES


@pytest.mark.parametrize("shape", [(1, 1), (1, 150), (150, 1), (2, 2)])
def test_maps_of_any_shape_can_be_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int]
) -> None:
    monkeypatch.setattr(figures, "_DPI", 30)  # the pixels do not matter
    assert len(write_figures(make_map(np.zeros(shape)), tmp_path, np.zeros(shape))) == 9


@pytest.mark.parametrize(("draw", "shape"), [(height_figure, (10, 30)), (layers_figure, (30, 10))])
def test_no_word_of_a_long_plan_is_cut(
    draw: Callable[[ElevationMap], Figure], shape: tuple[int, int]
) -> None:
    map_ = make_map(np.linspace(0.0, 1.0, 300).reshape(shape))
    with Image.open(io.BytesIO(png_bytes(draw(map_)))) as picture:
        grey = np.asarray(picture.convert("L"))
    assert all(np.all(edge == 255) for edge in (grey[0], grey[-1], grey[:, 0], grey[:, -1]))


def test_plans_have_units_equal_scales_and_the_right_place() -> None:
    map_ = hilly_map()
    for figure, unit in ((height_figure(map_), "[m]"), (sigma_figure(map_), "[mm]")):
        plan = figure.axes[0]
        assert plan.get_aspect() == 1.0
        assert plan.images[0].get_extent() == pytest.approx((-0.12, 1.48, 0.20, 1.40))
        assert (plan.get_xlabel(), plan.get_ylabel()) == ("x [m]", "y [m]")
        assert unit in figure.axes[1].get_ylabel()


def test_a_plan_shows_confirmed_cells_only() -> None:
    map_ = make_map([[0.0, 9.0, 0.1]], state=[[2, CellState.UNCONFIRMED, 3]])
    shown = height_figure(map_).axes[0].images[0].get_array()
    assert shown is not None
    np.testing.assert_array_equal(np.ma.getmaskarray(shown), [[False, True, False]])


def test_states_are_counted() -> None:
    bar = state_figure(make_map([[0.0, np.nan, 0.0]])).axes[1]
    labels = [text.get_text() for text in bar.get_yticklabels()]
    assert labels == [
        *("unknown\n1 cells", "unconfirmed\n0 cells", "measured\n2 cells"),
        *("uncertain\n0 cells", "filled\n0 cells", "occluded\n0 cells"),
    ]


@pytest.mark.parametrize("shape", [(8, 20), (20, 8)])
def test_the_layers_are_slope_and_traversability(shape: tuple[int, int]) -> None:
    _, x = np.mgrid[0 : shape[0], 0 : shape[1]] * 0.04
    figure = layers_figure(make_map(np.tan(np.radians(10.0)) * x))
    slope, traversability = (axes.images[0].get_array() for axes in figure.axes[:2])
    assert slope is not None
    assert traversability is not None
    np.testing.assert_allclose(slope, 10.0, rtol=1e-4)
    np.testing.assert_allclose(traversability, 1.0 - np.radians(10.0), rtol=1e-3)
    assert "Slope" in _words(figure)
    assert "slope [deg]" in _words(figure)


@pytest.mark.parametrize(
    ("sigma_m", "ends_mm"), [(0.003, (2, 5)), (5.0, (500, 1000)), (0, (0.1, 1))]
)
def test_a_uniform_sigma_has_a_scale(sigma_m: float, ends_mm: tuple[float, float]) -> None:
    figure = sigma_figure(make_map(np.zeros((3, 3)), sigma_m))
    assert figure.axes[0].images[0].get_clim() == pytest.approx(ends_mm)
    png_bytes(figure)


def test_the_longest_section_has_the_most_confirmed_cells() -> None:
    heights = np.full((4, 3), np.nan)
    heights[:, 1] = 0.0
    map_ = make_map(heights)
    section = longest_section(map_)
    assert section.start_m == (map_.x_m[1], map_.y_m[0])
    assert section.end_m == (map_.x_m[1], map_.y_m[3])
    assert section.length_m == pytest.approx(0.12)


def test_a_profile_follows_its_line_cell_by_cell() -> None:
    y, x = np.mgrid[0:20, 0:20] * 0.04
    map_ = make_map(x + 2.0 * y, first_x=0, first_y=0)
    figure = profile_figure(map_, Section((0.02, 0.02), (0.78, 0.78)))
    line = figure.axes[0].get_lines()[0]
    heights = np.asarray(line.get_ydata())
    assert heights[0] == pytest.approx(0.0)
    assert heights[-1] == pytest.approx(3 * 0.76)
    assert np.asarray(line.get_xdata())[-1] == pytest.approx(0.76 * 2**0.5)
    assert (np.diff(heights) > 0.0).all()
    assert "distance along the profile [m] | height z [m]" in _words(figure)


def test_a_profile_marks_where_the_truth_leaves_the_band() -> None:
    map_ = make_map(np.zeros((1, 5)), sigma_m=0.01)
    figure = profile_figure(map_, longest_section(map_), np.array([[0.0, 0.02, 0.05, 0.0, -0.04]]))
    marks = next(line for line in figure.axes[0].get_lines() if line.get_label() == "truth outside")
    np.testing.assert_allclose(np.asarray(marks.get_ydata()), [0.05, -0.04])


def test_a_profile_beside_the_map_is_refused() -> None:
    with pytest.raises(MappingError, match="meets no confirmed cell"):
        profile_figure(hilly_map(), Section((50.0, 50.0), (60.0, 50.0)))


def test_large_maps_are_thinned_and_the_title_says_so() -> None:
    title = _words(surface_figure(make_map(np.zeros((10, 200)))))
    assert "means of 4 x 4 cells" in title
    assert "times exaggerated" in title


def test_errors_and_their_consistency_are_shown() -> None:
    map_ = make_map(np.full((20, 20), 0.005), sigma_m=0.01)
    truth = np.zeros((20, 20))
    assert "100.0 % within 1" in _words(consistency_figure(map_, truth))
    assert "ANEES 0.25" in _words(consistency_figure(map_, truth))
    figure = error_figure(map_, truth)
    low, high = figure.axes[0].images[0].get_clim()
    assert low is not None
    assert high == pytest.approx(5.0, rel=1e-4)
    assert low == -high


def test_a_map_without_confirmed_cells_or_truth_is_refused(tmp_path: Path) -> None:
    empty = make_map([[0.0]], state=CellState.UNCONFIRMED)
    with pytest.raises(MappingError, match="no cell of the map is confirmed"):
        write_figures(empty, tmp_path)
    with pytest.raises(MappingError, match="no confirmed cell of the map has a true height"):
        write_figures(make_map([[0.0]]), tmp_path, np.array([[np.nan]]))
    with pytest.raises(MappingError, match=r"truth has shape \(2, 1\) and the map \(1, 1\)"):
        write_figures(make_map([[0.0]]), tmp_path, np.zeros((2, 1)))
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").touch()
    with pytest.raises(MappingError, match="is a file; give the name of a folder"):
        write_figures(hilly_map(), tmp_path / "file")


def test_the_range_of_nothing_and_of_one_value_is_not_empty() -> None:
    assert central_range(np.array([np.nan])) == (0.0, 1.0)
    low, high = central_range(np.array([2.0, 2.0]))
    assert low < 2.0 < high


class _DirtyNumpy:
    """numpy whose `empty` holds the largest numbers, as unfilled memory may."""

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)

    def empty(self, shape: tuple[int, ...]) -> NDArray[np.float64]:
        return np.full(shape, 1.7e308)


def test_memory_that_nobody_filled_raises_no_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(art3d, "np", _DirtyNumpy())
    assert len(png_bytes(surface_figure(hilly_map()))) > 10_000
