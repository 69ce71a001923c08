"""What faults leave of a depth image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers.samples import DepthFrame
from simulation.faults import BlindPatches, Fault

# Tells these random numbers from those of the camera's noise, which has the same seed and frame.
_STREAM = 1_000_003


def with_patches(frame: DepthFrame, faults: Sequence[Fault], t_s: float, seed: int) -> DepthFrame:
    """Return the frame with the patches that are blind at t_s seconds after the start."""
    active = [f for f in faults if isinstance(f, BlindPatches) and f.holds(t_s)]
    if not active:
        return frame
    depth_mm = frame.depth_mm.copy()
    height, width = depth_mm.shape
    for number, fault in enumerate(active):
        which = frame.sequence if fault.moving else 0
        random = np.random.default_rng([seed, which, number, _STREAM])
        half = max(round(fault.size * height), 1) / 2.0
        for row, column in random.random((fault.patches, 2)) * [height, width]:
            top, left = max(round(row - half), 0), max(round(column - half), 0)
            depth_mm[top : round(row + half), left : round(column + half)] = 0
    depth_mm.flags.writeable = False
    return replace(frame, depth_mm=depth_mm)
