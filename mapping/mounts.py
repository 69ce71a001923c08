"""Where sensors sit on the rover: the fixed transforms of a recording as a tree."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from acquisition.messages.frames import StaticTransform
from mapping.errors import MappingError
from mapping.geometry import RigidTransform
from mapping.mapper_counts import MapperCounts


class MountTree:
    """Fixed transforms between named frames, in whatever order they were published."""

    def __init__(self, counts: MapperCounts | None = None) -> None:
        """Start without any; `counts`: where it is counted that a mount was replaced."""
        self._counts = counts or MapperCounts()
        self._neighbours: dict[str, dict[str, RigidTransform]] = {}

    def add(self, transforms: Iterable[StaticTransform]) -> None:
        """Take transforms; a later one between the same two frames replaces the earlier.

        Raises:
            MappingError: a number is not finite, or a quaternion is no rotation.
        """
        for item in transforms:
            parent, child = item.parent_frame, item.child_frame
            try:
                to_parent = RigidTransform.from_quat_wxyz(item.position_m, item.quat_wxyz)
            except MappingError as error:
                raise MappingError(f"mount of {child} in {parent}: {error}") from error
            known = self._neighbours.get(parent, {}).get(child, to_parent)
            self._counts.mounts_replaced += not _are_same(known, to_parent)
            self._neighbours.setdefault(parent, {})[child] = to_parent
            self._neighbours.setdefault(child, {})[parent] = to_parent.inverse()

    def lookup(self, target: str, source: str) -> RigidTransform:
        """Return T_target_source: coordinates in `source` to coordinates in `target`.

        Raises:
            MappingError: the recording does not connect the two frames.
        """
        reached = self._reach(target, source)
        if source not in reached:
            known = ", ".join(sorted(self._neighbours)) or "none"
            raise MappingError(
                f"the stream's /tf_static does not connect {target} with {source} (frames found: "
                f"{known}); record the mount of the depth sensor"
            )
        return reached[source]

    def connects(self, target: str, source: str) -> bool:
        """Tell whether the recording connects two frames."""
        return source in self._reach(target, source)

    def _reach(self, target: str, source: str) -> dict[str, RigidTransform]:
        """Return T_target_frame of the frames that are found on the way to `source`."""
        reached = {target: RigidTransform.identity()}
        queue = [target]
        while queue and source not in reached:
            frame = queue.pop(0)
            for neighbour, transform in self._neighbours.get(frame, {}).items():
                if neighbour not in reached:
                    reached[neighbour] = reached[frame] @ transform
                    queue.append(neighbour)
        return reached


def _are_same(one: RigidTransform, other: RigidTransform) -> bool:
    """Tell whether two mounts agree, but for what rounding makes of an inverse."""
    turned = np.allclose(one.rotation, other.rotation, rtol=0.0, atol=1e-9)
    return turned and np.allclose(one.translation_m, other.translation_m, rtol=0.0, atol=1e-9)
