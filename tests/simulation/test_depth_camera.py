import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.samples import DepthFrame
from simulation.devices.camera_mount import BODY_FROM_OPTICAL
from simulation.devices.depth_camera import DepthCamera
from simulation.devices.ideal_camera import trace
from simulation.devices.kinect import KinectModel, kinect_320, kinect_640, lit_by_projector
from simulation.devices.ray_kernels import block_maxima, first_hit
from simulation.errors import SimulationError
from simulation.terrain.analytic import crater_field
from simulation.terrain.height_grid import HeightGrid
from simulation.terrain.lunar_terrain import lunar_terrain
from simulation.terrain.man_made import indoor_hall

Pose = tuple[NDArray[np.float64], NDArray[np.float64]]


def pose(x: float, y: float, z: float, yaw_deg: float = 10.0, down_deg: float = 25.0) -> Pose:
    body = Rotation.from_euler("ZYX", [yaw_deg, down_deg, 2.0], degrees=True).as_matrix()
    return np.array([x, y, z]), body @ BODY_FROM_OPTICAL


@pytest.fixture(scope="module")
def ground() -> HeightGrid:
    return lunar_terrain("nominal", 7, extent=(-2.0, 6.0, -3.0, 3.0)).grid


def test_clean_depth_lies_on_the_ground(ground: HeightGrid) -> None:
    camera = DepthCamera(ground, kinect_320(), KinectModel(), 0)
    place = pose(0.0, 0.0, 0.5)
    view = camera.look(*place)
    points = camera.visible_points(view, *place, np.ones(view.z_m.shape, bool))
    error = points[:, 2] - ground.height_at(points[:, 0], points[:, 1])
    assert points.shape[0] > 20_000
    assert np.abs(error).max() < 1e-9


def test_clean_depth_in_millimetres_has_no_bias(ground: HeightGrid) -> None:
    camera = DepthCamera(ground, kinect_320(), KinectModel(), 0)
    position, rotation = pose(0.0, 0.0, 0.5)
    view = camera.look(position, rotation)
    v, u = np.nonzero((view.z_m > 0.8) & (view.z_m < 4.0))
    z = np.rint(view.z_m[v, u] * 1000.0) / 1000.0
    optical = np.column_stack([(u - 159.5) / 290.0 * z, (v - 119.5) / 290.0 * z, z])
    points = optical @ rotation.T + position
    error = points[:, 2] - ground.height_at(points[:, 0], points[:, 1])
    assert abs(error.mean()) < 1e-4
    assert error.std() < 5e-4


def test_depth_agrees_with_a_surface_in_closed_form() -> None:
    surface = crater_field(2, 6.0, 6.0)
    x = np.linspace(-1.0, 7.0, 801)
    y = np.linspace(-3.0, 3.0, 601)
    heights = surface.height_m(x[np.newaxis, :], y[:, np.newaxis])
    grid = HeightGrid(-1.0, -3.0, 0.01, heights.astype(np.float32))
    place = pose(0.0, 0.0, 0.5 + float(surface.height_m(np.array(0.0), np.array(0.0))))
    view = DepthCamera(grid, kinect_320(), KinectModel(), 0).look(*place)
    exact, incidence = trace(surface, kinect_320(), *place, 4.4)
    both = (view.z_m > 0.0) & (exact > 0.0)
    assert both.sum() > 60_000
    assert np.median(np.abs(view.z_m - exact)[both]) <= 1e-4
    apart = np.abs(np.arccos(view.cos_incidence) - incidence)[both]
    assert np.degrees(np.median(apart)) < 0.5


def test_incidence_and_sun_on_a_slope_are_exact() -> None:
    x = np.linspace(-5.0, 5.0, 101)
    grid = HeightGrid(-5.0, -5.0, 0.1, np.tile(0.75 * x, (101, 1)).astype(np.float32))
    straight_down = np.diag([1.0, -1.0, -1.0])
    camera = DepthCamera(grid, kinect_320(), KinectModel(), 0, sun=(-2.0, 0.0, 0.0))
    view = camera.look(np.array([0.0, 0.0, 2.0]), straight_down)
    ray_x, ray_y = (-0.5 / 290.0, -0.5 / 290.0)
    cosine = (0.6 * ray_x + 0.8) / np.sqrt(1.0 + ray_x**2 + ray_y**2)
    assert view.cos_incidence[119, 159] == pytest.approx(cosine, abs=1e-6)
    assert view.cos_sun[119, 159] == pytest.approx(0.6, abs=1e-6)
    dark = DepthCamera(grid, kinect_320(), KinectModel(), 0, sun=(1.0, 0.0, 0.1))
    assert not dark.look(np.array([0.0, 0.0, 2.0]), straight_down).cos_sun.any()


def test_there_is_nothing_to_see_in_the_sky_and_under_the_ground(ground: HeightGrid) -> None:
    camera = DepthCamera(ground, kinect_320(), KinectModel(), 0)
    assert not camera.look(*pose(0.0, 0.0, 0.5, down_deg=-60.0)).z_m.any()
    assert not camera.look(*pose(0.0, 0.0, -3.0)).z_m.any()
    frame = camera.frame(camera.look(*pose(0.0, 0.0, -3.0)), 0, 1)
    assert not frame.depth_mm.any()


def test_the_frame_carries_stamp_number_and_intrinsics(ground: HeightGrid) -> None:
    camera = DepthCamera(ground, kinect_640(), KinectModel(), 3)
    view = camera.look(*pose(0.0, 0.0, 0.5))
    frame = camera.frame(view, 4, 123)
    assert (frame.t_ns, frame.sequence, frame.camera) == (123, 4, kinect_640())
    assert frame.depth_mm.shape == (480, 640)
    assert not frame.depth_mm.flags.writeable
    kept = frame.depth_mm > 0
    assert 0.4 < kept.mean() < 0.9
    error = frame.depth_mm[kept] / 1000.0 - view.z_m[kept]
    assert abs(error.mean()) < 1e-3
    assert (camera.frame(view, 5, 123).depth_mm != frame.depth_mm).any()


def test_same_seed_same_frame(ground: HeightGrid) -> None:
    """For another process see `tests/test_cli.py`, which simulates all devices in one."""

    def frame(seed: int) -> DepthFrame:
        camera = DepthCamera(ground, kinect_320(), KinectModel(sunlight=0.05), seed)
        return camera.frame(camera.look(*pose(0.0, 0.0, 0.5)), 2, 0)

    np.testing.assert_array_equal(frame(11).depth_mm, frame(11).depth_mm)
    assert (frame(12).depth_mm != frame(11).depth_mm).any()


@pytest.mark.parametrize(
    ("seed", "sun", "message"),
    [(-1, (0.0, 0.0, 1.0), "seed -1"), (0, (0.0, 0.0, 0.0), "sun"), (0, (0.0, 0.0, np.inf), "sun")],
)
def test_impossible_cameras_are_refused(
    ground: HeightGrid, seed: int, sun: tuple[float, float, float], message: str
) -> None:
    with pytest.raises(SimulationError, match=message):
        DepthCamera(ground, kinect_320(), KinectModel(), seed, sun)


def test_the_projector_s_shadow_is_where_rays_from_it_do_not_arrive() -> None:
    hall = indoor_hall(1)
    camera = DepthCamera(hall, kinect_320(), KinectModel(), 0)
    position, rotation = pose(-0.5, 0.0, 0.5, yaw_deg=60.0, down_deg=15.0)
    view = camera.look(position, rotation)
    v, u = np.nonzero(view.z_m)
    z = view.z_m[v, u]
    optical = np.column_stack([(u - 159.5) / 290.0 * z, (v - 119.5) / 290.0 * z, z])
    projector = position + rotation @ [0.075, 0.0, 0.0]
    highest = block_maxima(hall.height_m)
    scale = np.array([0.02, 0.02, 1.0])
    start = (projector - [hall.origin_x_m, hall.origin_y_m, 0.0]) / scale
    rays = (optical @ rotation.T + position - projector) / scale
    first = [first_hit(hall.height_m, highest, tuple(start), tuple(ray), 1.0) for ray in rays]
    reached = np.abs(np.array(first)) > 0.995
    lit = lit_by_projector(view, kinect_320(), KinectModel())[v, u]
    assert (~reached).sum() > 200
    # They differ by half a pixel along the edges of the shadow.
    assert (lit != reached).sum() < 0.15 * (~reached).sum()
