"""Same samples, same bits: in another process, compiled anew, for another processor."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from drivers.samples import DepthFrame
from mapping.mapper import Mapper
from mapping.noise import KINECT_V1
from mapping.settings import MapSettings
from tests.mapping.scenes import CAMERA, looking, millimetres, mount, plane_z, pose_sample

_ROOT = Path(__file__).resolve().parents[2]
_PRINT = "from tests.mapping.test_determinism import fingerprint; print(fingerprint())"


def fingerprint() -> str:
    """Return the SHA-256 of a map of rough slopes, seen from wobbling poses with holes."""
    random = np.random.default_rng(11)
    mapper = Mapper(MapSettings(mount_sigma_rad=0.005), KINECT_V1)
    mapper.add(mount((0.1, -0.05, 0.2), (0.8, 0.0, 0.6, 0.0)))
    covariance = np.diag([1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-4])
    for n in range(20):
        rotation = looking(*(10.0 * random.standard_normal(3) + (15.0 * n, 50.0, 0.0)))
        position = random.standard_normal(3) * 0.2 + (0.0, 0.0, 1.0)
        z_m = plane_z(CAMERA, rotation, (0.2, -0.1, 1.0), -1.0)
        z_m *= 1.0 + 0.03 * random.standard_normal(z_m.shape)
        z_m[random.random(z_m.shape) < 0.1] = 0.0
        mapper.add(pose_sample(n * 50_000_000, position, rotation, covariance))
        mapper.add(DepthFrame(n * 50_000_000, millimetres(np.clip(z_m, 0, 60)), CAMERA, n))
    mapper.finish()
    assert min(mapper.counts.rejected, mapper.counts.updates) > 100
    return mapper.elevation_map().sha256()


def test_another_process_with_kernels_for_a_plainer_processor_makes_the_same_map(
    tmp_path: Path,
) -> None:
    """Shorter vectors, no fused multiply-add; and compiled from scratch, into an empty cache.

    A process with this processor's kernels is compared in `tests/test_cli.py`.
    """
    with subprocess.Popen(
        [sys.executable, "-c", _PRINT],
        cwd=_ROOT,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_CPU_NAME": "generic"},
        stdout=subprocess.PIPE,
        text=True,
    ) as other:  # it compiles while we map
        here = fingerprint()
        there, _ = other.communicate()
    assert other.returncode == 0
    assert there.strip() == here
    assert any(tmp_path.rglob("*.nbi"))
