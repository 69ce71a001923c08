"""The source of poses that the settings ask for."""

from __future__ import annotations

from mapping.geometry import UncertainPose
from mapping.motion.pose_errors import ABSOLUTE, RELATIVE, PoseErrorModel
from mapping.poses.estimated import EstimatedPoses
from mapping.poses.recorded import RecordedPoses
from mapping.poses.source import PoseSource
from mapping.settings import MapSettings


def is_aligned(settings: MapSettings) -> bool:
    """Tell whether frames are aligned with the map before they are mapped."""
    return settings.pose_source.endswith("+alignment")


def pose_errors_for(settings: MapSettings) -> PoseErrorModel:
    """Return where the errors of those poses are counted."""
    if is_aligned(settings):
        return settings.aligned_errors
    return ABSOLUTE if settings.pose_source == "mocap" else RELATIVE


def pose_source_for(settings: MapSettings, start: UncertainPose | None = None) -> PoseSource:
    """Return a new source of poses; `start`: where the run before ended, for a source that asks."""
    if settings.pose_source.startswith("mocap"):
        return RecordedPoses(settings.pose_gap_max_s)
    return EstimatedPoses(
        settings.ego_motion, settings.tilt_source, aligned=is_aligned(settings), start=start
    )
