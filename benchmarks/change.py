"""How soon a map shows what has come, forgets what has gone, and keeps what is thin.

    python benchmarks/change.py [--seeds N] [--json FILE]

A camera 0.5 m above a floor looks 20 degrees down. A box or pillar appears after two seconds and
leaves after five: on open ground, behind a sill that hides its ground, and a pillar whose top is
out of view. "Shown": from then on 9 of 10 of its cells are high; "gone": from then on none is; both
until the end of their phase, in seconds of sensor time, the slowest of the seeds. A thin post, 4 or
8 cm, is driven past with a limit of 5 frames; counted are seeds in which the map still has it at
the end. The poses are exact, or wrong by Gauss-Markov errors with a time of 0.3 s that the mapper
is told of.
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where `mapping.py` would hide the package.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.samples import CameraIntrinsics
from mapping.kernel_cache import compile_kernels
from mapping.mapper import Mapper
from mapping.noise import KINECT_V1
from mapping.settings import MapSettings
from simulation.devices.kinect import kinect_320, kinect_640
from tests.mapping.boxes import Box, PoseNoise, Stage
from tests.mapping.scenes import mount

_CAMERAS = {"320x240": (kinect_320(), 10), "640x480": (kinect_640(), 30)}
_NOISES = {"exact": (0.0, 0.0), "3 mm 0.2 deg": (0.003, 0.2), "10 mm 0.5 deg": (0.010, 0.5)}
_BOX: Box = (1.5, -0.2, 0.0, 1.7, 0.2, 0.35)
_SILL: Box = (1.2, -1.0, 0.0, 1.24, 1.0, 0.2)
_WALL: Box = (3.0, -3.0, 0.0, 3.2, 3.0, 2.0)
_PILLAR: Box = (1.52, -0.1, 0.0, 1.7, 0.1, 2.0)
_PILLAR_FRONT: Box = (1.52, -0.08, 0.0, 1.56, 0.08, 2.0)
_BEFORE_S, _THERE_S, _AFTER_S = 2, 3, 3
_SHOWN_BAR_S, _GONE_BAR_S = 1.0, 2.0


@dataclass(frozen=True, slots=True)
class Scene:
    """What stays, what comes and goes, where to look for it, and how high it must be."""

    always: tuple[Box, ...]
    thing: Box
    cells: Box
    high_m: float
    pitch_deg: float = 20.0


_SCENES = {
    "box, open ground": Scene((), _BOX, _BOX, 0.25),
    "box behind a sill": Scene((_SILL, _WALL), _BOX, _BOX, 0.25),
    "pillar, top unseen": Scene((), _PILLAR, _PILLAR_FRONT, 0.25, 5.0),
}


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table; times of the slowest seed, infinite where it never happened."""

    scene: str
    image: str
    poses: str
    seeds: int
    shown_s: float
    gone_s: float


@dataclass(frozen=True, slots=True)
class Post:
    """One line of the posts: how many of them are still there, and cells forgotten by the way."""

    image: str
    poses: str
    driven_past: int
    survived: int
    lowest_m: float
    cleared: int


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    compile_kernels()
    cases = [(image, poses) for image in _CAMERAS for poses in _NOISES]
    rows = [_row(scene, *case, options.seeds) for scene in _SCENES for case in cases]
    posts = [_posts(*case, options.seeds) for case in cases]
    print(f"{'scene':>20} {'image':>8} {'poses':>14} {'shown s':>8} {'gone s':>7}")
    for r in rows:
        print(f"{r.scene:>20} {r.image:>8} {r.poses:>14} {r.shown_s:>8.2f} {r.gone_s:>7.2f}")
    print(f"bars: shown within {_SHOWN_BAR_S:g} s, gone within {_GONE_BAR_S:g} s; slowest seed")
    for p in posts:
        print(
            f"{'thin posts':>20} {p.image:>8} {p.poses:>14} {p.survived} of {p.driven_past} "
            f"survive, the lowest {p.lowest_m:.2f} m high in the map; {p.cleared} cells forgotten"
        )
    if options.json:
        content = {"rows": [asdict(r) for r in rows], "posts": [asdict(p) for p in posts]}
        options.json.write_text(json.dumps(content, indent=2) + "\n")


def _stage(image: str, poses: str, seed: int) -> tuple[Stage, int]:
    camera: CameraIntrinsics
    camera, rate_hz = _CAMERAS[image]
    mapper = Mapper(MapSettings(), KINECT_V1)
    mapper.add(mount())
    sigma_m, sigma_deg = _NOISES[poses]
    noise = PoseNoise(sigma_m, math.radians(sigma_deg))
    return Stage(mapper, seed, camera, rate_hz, noise), rate_hz


def _row(name: str, image: str, poses: str, seeds: int) -> Row:
    times = [_times(_SCENES[name], image, poses, seed) for seed in range(seeds)]
    shown, gone = map(max, zip(*times, strict=True))
    return Row(name, image, poses, seeds, shown, gone)


def _times(scene: Scene, image: str, poses: str, seed: int) -> tuple[float, float]:
    """Return after how many seconds the thing was shown, and gone, for good."""
    stage, rate_hz = _stage(image, poses, seed)
    there, gone = [], []
    for _ in range(_BEFORE_S * rate_hz):
        stage.see(scene.always, pitch_deg=scene.pitch_deg)
    for _ in range(_THERE_S * rate_hz):
        stage.see((*scene.always, scene.thing), pitch_deg=scene.pitch_deg)
        there.append(_high(stage, scene).mean() >= 0.9)
    for _ in range(_AFTER_S * rate_hz):
        stage.see(scene.always, pitch_deg=scene.pitch_deg)
        gone.append(not _high(stage, scene).any())
    return _since(there) / rate_hz, _since(gone) / rate_hz


def _high(stage: Stage, scene: Scene) -> NDArray[np.bool_]:
    heights, _ = stage.heights(scene.cells)
    high: NDArray[np.bool_] = heights > scene.high_m
    return high if high.size else np.zeros(1, np.bool_)


def _since(true: list[bool]) -> float:
    """Return the number of frames up to the first from which on all are true."""
    wrong = np.flatnonzero(~np.array(true))
    first = int(wrong[-1]) + 1 if wrong.size else 0
    return math.inf if first == len(true) else first + 1.0


def _posts(image: str, poses: str, seeds: int) -> Post:
    heights = []
    cleared = 0
    for seed in range(seeds):
        for width_m, offset_m in ((0.04, 0.02), (0.04, 0.0), (0.08, 0.01)):
            stage, rate_hz = _stage(image, poses, seed)
            x = 1.0 + offset_m
            post: Box = (x, 0.1, 0.0, x + width_m, 0.1 + width_m, 0.5)
            for n in range(4 * rate_hz):  # 2 m in 4 s, to beside the post
                at = n / rate_hz
                place = (-1.0 + 0.5 * at, 0.0, 0.4 + 0.1 * math.sin(3.0 * at))
                stage.see([post, _WALL], place, 5.0 * math.sin(2.0 * at))
            around: Box = (x - 0.03, 0.07, 0.0, x + width_m + 0.03, 0.13 + width_m, 0.5)
            heights.append(float(np.nanmax(stage.heights(around)[0])))
            cleared += stage.mapper.counts.cleared
    survived = sum(height > 0.1 for height in heights)
    return Post(image, poses, len(heights), survived, min(heights), cleared)


if __name__ == "__main__":
    main()
