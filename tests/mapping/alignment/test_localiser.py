"""Frames that fit the map, that fit it nowhere, and a map that has slid."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.samples import AccelerationSample, frozen_array
from mapping.alignment.fusion import moved
from mapping.alignment.gravity import GravitySettings
from mapping.alignment.localiser import Localiser
from mapping.alignment.settings import AlignmentSettings
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.geometry import RigidTransform, UncertainPose
from mapping.mounts import MountTree
from mapping.poses.estimated import EstimatedPoses
from tests.mapping.alignment.ground import MOUNT, Site, bumps

LOOSE = np.diag([0.03**2] * 3 + [np.radians(2.0) ** 2] * 3)


@pytest.fixture(scope="module")
def site() -> Site:
    site = Site(bumps)
    site.build()
    return site


def _localiser(gravity: GravitySettings | None = None) -> Localiser:
    poses = EstimatedPoses(EgoMotionSettings(), "levelled", aligned=True)
    settings = AlignmentSettings(most_misfits=3)
    return Localiser(poses, MountTree(), settings, gravity or GravitySettings(), 0.04)


def _refine(
    localiser: Localiser, site: Site, prior: RigidTransform, t_ns: int = 0
) -> UncertainPose | None:
    return localiser.refine(site.reducer, UncertainPose(t_ns, prior, LOOSE), MOUNT, site.grid)


def test_a_frame_that_fits_nowhere_is_left_out_for_a_while(site: Site) -> None:
    localiser = _localiser()
    site.look(site.pose(0.12))
    # Seen from a place 12 cm lower than claimed, and turned: beyond what is believed.
    prior = moved(site.pose(0.12), np.array([0.0, 0.0, 0.11, 0.12, 0.1, 0.2]))
    found = [_refine(localiser, site, prior) for _ in range(4)]
    assert found[:3] == [None] * 3
    assert found[3] is not None
    assert found[3].transform is prior
    assert (localiser.counts.misfits, localiser.counts.aligned) == (4, 0)
    assert _refine(localiser, site, site.pose(0.12)) is not None
    assert _refine(localiser, site, prior) is None


def test_a_map_that_leans_is_noticed(site: Site) -> None:
    """Gravity is felt 5 degrees off what the map says, for seven seconds at rest."""
    localiser = _localiser(GravitySettings(window_s=1.0, levelling_sigma_rad=0.02))
    site.look(site.pose(0.12))
    lean = np.radians(5.0)
    force = frozen_array(9.81 * np.array([np.sin(lean), 0.0, np.cos(lean)]), (3,))
    for n in range(14):
        t_ns = n * 100_000_000
        localiser.add(AccelerationSample(t_ns, force, n))
        assert _refine(localiser, site, site.pose(0.12), t_ns) is not None
    assert localiser.counts.slid > 2
    assert localiser.slid_rad == pytest.approx(lean, abs=0.01)
