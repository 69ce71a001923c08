"""What became of the input of a mapper."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class MapperCounts:
    """What became of the input.

    Attributes:
        frames: depth frames mapped.
        frames_without_pose: depth frames left out because no pose surrounds their time.
        frames_known: depth frames left out because the world has them from a run before.
        poses, poses_out_of_order: poses taken; poses left out because they came out of order.
        readings: valid depth readings of the mapped frames, without those dropped (below).
        readings_outside: readings of them that fell outside the grid.
        readings_uncalibrated: readings of them at distances that the calibration does not cover;
            mapped with the fallback's noise.
        camera_changes: frames whose intrinsics are others than those of the frame before.
        mounts_replaced: mounts that were given a second time with other numbers.
        updates: cell updates. rejected: those that went to a second hypothesis. replaced: second
            hypotheses that took over. cleared: cells forgotten because rays passed through them.
        readings_own_body: readings dropped because they hit the rover itself.
        readings_overhanging: readings dropped because they hit what hangs high above the ground.
        motions: relative motions taken. motions_clipped: those whose covariance had a negative
            eigenvalue.
        pose_events: things that estimated poses suffered from.
        aligned, unaligned, misfits, slid: frames whose pose the map corrected; to which it had
            nothing to say; which fitted it nowhere and were, for a while, not mapped; at which the
            map's idea of gravity was found wrong.
    """

    frames: int = 0
    frames_without_pose: int = 0
    frames_known: int = 0
    poses: int = 0
    poses_out_of_order: int = 0
    readings: int = 0
    readings_outside: int = 0
    readings_uncalibrated: int = 0
    camera_changes: int = 0
    mounts_replaced: int = 0
    updates: int = 0
    rejected: int = 0
    replaced: int = 0
    cleared: int = 0
    readings_own_body: int = 0
    readings_overhanging: int = 0
    motions: int = 0
    motions_clipped: int = 0
    pose_events: int = 0
    aligned: int = 0
    unaligned: int = 0
    misfits: int = 0
    slid: int = 0
