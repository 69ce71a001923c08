"""Settings that no map can be made with are refused when they are made."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from mapping.ego_motion.settings import EgoMotionSettings
from mapping.errors import MappingError
from mapping.settings import MapSettings

MAY_BE_ZERO = {
    "common_correlation_time_s",
    "relief_share",
    "relief_frames",
    "mount_sigma_m",
    "mount_sigma_rad",
    "seen_through_frames",
    "overhang_clearance_m",
}
NUMBERS = [item.name for item in fields(MapSettings) if isinstance(item.default, int | float)]


def test_the_docs_name_every_setting_of_ego_motion() -> None:
    text = (Path(__file__).parents[2] / "docs" / "ego_motion.md").read_text()
    rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| `")]
    told = {
        name.strip("`"): value
        for names, values, *_ in rows
        for name, value in zip(
            names.removeprefix("| ").split(", "), values.split(", "), strict=True
        )
    }
    ours = {item.name: item.default for item in fields(EgoMotionSettings)}
    assert told.keys() == ours.keys()
    for name, value in ours.items():
        assert told[name] == (str(value).lower() if isinstance(value, bool) else f"{value:g}")


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", [-1, math.nan, math.inf])
def test_every_number_must_be_finite_and_not_negative(name: str, value: float) -> None:
    changes: dict[str, Any] = {name: value}
    with pytest.raises(MappingError, match=f"^{name} is {value}; expected"):
        MapSettings(**changes)


@pytest.mark.parametrize("name", NUMBERS)
def test_zero_is_allowed_where_it_means_something(name: str) -> None:
    changes: dict[str, Any] = {name: 0}
    if name in MAY_BE_ZERO:
        assert getattr(MapSettings(**changes), name) == 0
    else:
        with pytest.raises(MappingError, match=f"^{name} is 0; expected a number above 0"):
            MapSettings(**changes)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"range_min_m": 4.0}, "range_min_m is 4.0 and range_max_m is 4.0; expected range_min_m"),
        ({"sigma_floor_m": 2.0}, "expected sigma_floor_m below sigma_ceiling_m"),
        ({"window_m": 0.04}, "expected resolution_m below window_m"),
        ({"resolution_m": 4.0}, "of a cell, is 4 m; expected at most 0.5 m: give metres, 4 cm"),
        ({"grid": "round"}, "grid is 'round'; expected growing or scrolling"),
        ({"confirmations": 256}, "confirmations is 256; expected at most 255"),
        ({"seen_through_frames": 256}, "seen_through_frames is 256; expected at most 255"),
        ({"body_boxes_m": [(0, 0, 0, 1, 1)]}, r"body_boxes_m has \(0, 0, 0, 1, 1\); expected"),
        ({"body_boxes_m": [5]}, "body_boxes_m has 5; expected"),
        ({"body_boxes_m": [(0, 0, 0, 1, 1, "1")]}, "each minimum below its maximum"),
        ({"body_boxes_m": [(0, 0, 1, 1, 1, 1)]}, "each minimum below its maximum"),
        ({"body_boxes_m": [(0, 0, math.nan, 1, 1, 1)]}, "each minimum below its maximum"),
    ],
)
def test_what_contradicts_itself_is_refused(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(MappingError, match=reason):
        MapSettings(**changes)


def test_the_defaults_work() -> None:
    assert MapSettings().grid == "growing"
