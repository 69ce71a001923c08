from collections.abc import Callable

import numpy as np
import pytest

from simulation.errors import SimulationError
from simulation.terrain.height_grid import HeightGrid
from simulation.terrain.man_made import indoor_hall, outdoor_field

Scene = Callable[[int], HeightGrid]
SCENES = pytest.mark.parametrize("scene", [indoor_hall, outdoor_field])


@SCENES
def test_scenes_depend_on_the_seed_alone(scene: Scene) -> None:
    assert scene(3).height_m.tobytes() == scene(3).height_m.tobytes()
    assert scene(3).height_m.tobytes() != scene(4).height_m.tobytes()
    with pytest.raises(SimulationError, match="seed -1"):
        scene(-1)


def test_the_hall_is_flat_but_for_boxes_and_carpet() -> None:
    for seed in range(10):
        hall = indoor_hall(seed)
        x, y = np.meshgrid(hall.x_m, hall.y_m)
        on_axis = np.abs(y) <= 0.5
        on_carpet = (x >= 2.0) & (x <= 5.0) & (np.abs(y) <= 1.2)
        assert not hall.height_m[on_axis & ~on_carpet].any()
        carpet = hall.height_m[on_carpet & on_axis]
        assert carpet.min() >= 0.0
        assert 0.02 < carpet.max() < 0.05
        assert 0.1 <= hall.height_m.max() <= 0.45


def test_the_field_has_weeds_beside_the_axis() -> None:
    field = outdoor_field(2)
    y = np.abs(field.y_m)
    steep = np.abs(np.diff(field.height_m, axis=1)) > 0.04
    assert np.count_nonzero(steep[y > 0.7]) > 500
    assert not steep[y < 0.5].any()
    assert field.height_at(0.0, 0.0) == pytest.approx(0.0, abs=1e-6)
