"""Roughness around a cell, against numpy's least squares."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mapping.cells.relief_kernels import surrounding_relief

SHAPE = (9, 11)


def relief_of(
    height_m: NDArray[np.float64],
    variance_m2: float = 0.0,
    confirmed: NDArray[np.bool_] | None = None,
) -> NDArray[np.float32]:
    out = np.full(height_m.shape, np.nan, np.float32)
    known = np.ones(height_m.shape, np.bool_) if confirmed is None else confirmed
    surrounding_relief(height_m, np.full(height_m.shape, variance_m2, np.float32), known, out)
    return out


def oracle(height_m: NDArray[np.float64], confirmed: NDArray[np.bool_], j: int, i: int) -> float:
    rows, columns = np.nonzero(confirmed)
    near = (abs(rows - j) <= 2) & (abs(columns - i) <= 2)
    y, x = rows[near], columns[near]
    terms = np.stack([np.ones(len(x)), x - i, y - j], axis=1)
    if len(x) < 6 or np.linalg.matrix_rank(terms) < 3:
        return 0.0
    heights = height_m[y, x]
    fitted = terms @ np.linalg.lstsq(terms, heights, rcond=None)[0]
    return float(np.sum((heights - fitted) ** 2) / (len(x) - 3))


@given(st.integers(0, 2**32 - 1), st.floats(0.3, 1.0), st.floats(-1e4, 1e4))
def test_it_is_the_residual_variance_of_a_plane(seed: int, share: float, level: float) -> None:
    random = np.random.default_rng(seed)
    height = level + random.normal(0.0, 0.02, SHAPE)
    confirmed = random.random(SHAPE) < share
    found = relief_of(height, confirmed=confirmed)
    for j, i in np.ndindex(SHAPE):
        expected = oracle(height, confirmed, j, i) if confirmed[j, i] else 0.0
        assert found[j, i] == pytest.approx(expected, rel=1e-4, abs=1e-9)


@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(-100.0, 100.0))
def test_a_plane_is_not_rough(a: float, b: float, level: float) -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    assert relief_of(level + 0.04 * (a * x + b * y)).max() < 1e-10


def test_noise_that_the_cells_admit_is_taken_off() -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.003, (200, 200))
    assert relief_of(noise).mean() == pytest.approx(0.003**2, rel=0.02)
    assert relief_of(noise, 0.003**2).mean() < 0.2 * 0.003**2
    assert not relief_of(noise, 1.0).any()


def test_cells_in_a_line_or_alone_say_nothing() -> None:
    height = np.random.default_rng(2).normal(0.0, 0.1, SHAPE)
    line = np.zeros(SHAPE, np.bool_)
    line[4, :] = True
    assert not relief_of(height, confirmed=line).any()
    assert not relief_of(height, confirmed=np.zeros(SHAPE, np.bool_)).any()


def test_unconfirmed_cells_count_neither_as_ground_nor_as_a_cell() -> None:
    height = np.zeros(SHAPE)
    height[4, 5] = 3.0
    confirmed = np.ones(SHAPE, np.bool_)
    confirmed[4, 5] = False
    assert not relief_of(height, confirmed=confirmed).any()
