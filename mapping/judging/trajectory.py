"""Trajectories to compare: TUM files, NetCDF files with covariances, recordings with poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from acquisition.messages.frames import BASE_FRAME, MOCAP_BODY_FRAME, StaticTransforms
from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.reader import StreamReader
from drivers.depth.trajectory import Trajectory, read_trajectory
from drivers.samples import PoseSample
from mapping.errors import MappingError
from mapping.files import write_whole
from mapping.geometry import Float64Array, RigidTransform, UncertainPose
from mapping.mounts import MountTree
from mapping.output.netcdf import read_netcdf, what_lacks, write_netcdf

Int64Array = NDArray[np.int64]

_TIME = {"units": "nanoseconds since 1970-01-01", "long_name": "time of the recording"}


@dataclass(frozen=True, slots=True)
class Path3D:
    """Poses of one body in a fixed frame whose z axis is up.

    Attributes:
        name: where they come from.
        t_ns: (N,) strictly increasing.
        position_m: (N, 3) of the body.
        rotation: N rotations, body to fixed axes.
        covariance: (N, 6, 6) of (x, y, z, rotation about the fixed x, y, z), or None.
    """

    name: str
    t_ns: Int64Array
    position_m: Float64Array
    rotation: Rotation
    covariance: Float64Array | None = None

    def __len__(self) -> int:
        return len(self.t_ns)

    def at(self, t_ns: Int64Array, max_gap_s: float) -> tuple[Path3D, NDArray[np.bool_]]:
        """Return the poses at the times that two poses close enough surround, and which those are.

        Position is linear between two poses, rotation turns at constant rate.
        """
        right = np.clip(np.searchsorted(self.t_ns, t_ns), 1, len(self) - 1)
        gap_ns = self.t_ns[right] - self.t_ns[right - 1]
        inside = (t_ns >= self.t_ns[0]) & (t_ns <= self.t_ns[-1]) & (gap_ns <= max_gap_s * 1e9)
        wanted = t_ns[inside]
        known_s, wanted_s = ((t - self.t_ns[0]) * 1e-9 for t in (self.t_ns, wanted))
        position = np.column_stack([np.interp(wanted_s, known_s, p) for p in self.position_m.T])
        rotation = Slerp(known_s, self.rotation)(np.clip(wanted_s, known_s[0], known_s[-1]))
        return Path3D(self.name, wanted, position, rotation), inside


def read_path(path: Path) -> Path3D:
    """Read a trajectory: `.nc` (ours, or the truth of a simulation), `.mcap`, else a TUM file.

    Raises:
        MappingError: it holds no poses, or fewer than two.
        DriverError, StreamError: the file cannot be read.
    """
    if path.suffix == ".nc":
        found = _read_netcdf(path)
    elif path.suffix == ".mcap":
        found = _read_recording(path)
    else:
        tum = read_trajectory(path)
        found = Path3D(str(path), tum.t_ns, tum.position_m, Rotation.from_quat(tum.quat_xyzw))
    if len(found) < 2:
        raise MappingError(f"{path} holds {len(found)} poses; expected two or more")
    return found


def read_trajectory_of(path: Path) -> Trajectory:
    """Read a trajectory of any of these kinds as plain poses.

    Raises:
        MappingError, DriverError, StreamError: as `read_path`.
    """
    found = read_path(path)
    return Trajectory(path, found.t_ns, found.position_m, found.rotation.as_quat())


def write_path(path: Path, poses: Sequence[UncertainPose]) -> None:
    """Write poses: `.nc` with covariances, else a TUM file.

    Raises:
        MappingError: there are no poses, or the file cannot be written.
    """
    if not poses:
        raise MappingError(f"no pose was found; nothing to write to {path}")
    t_ns = np.array([pose.t_ns for pose in poses], np.int64)
    position = np.array([pose.transform.translation_m for pose in poses])
    rotation = Rotation.from_matrix(np.array([pose.transform.rotation for pose in poses]))
    if path.suffix == ".nc":
        covariance = np.array([pose.covariance for pose in poses])
        write_netcdf(_dataset(t_ns, position, rotation, covariance), path)
        return
    lines = ["# stamp tx ty tz qx qy qz qw"]
    for time, p, q in zip(t_ns.tolist(), position, rotation.as_quat(canonical=True), strict=True):
        numbers = " ".join(f"{value:.9f}" for value in (*p, *q))
        lines.append(f"{time // 10**9}.{time % 10**9:09d} {numbers}")
    write_whole(path, ("\n".join(lines) + "\n").encode("ascii"))


def _dataset(
    t_ns: Int64Array, position: Float64Array, rotation: Rotation, covariance: Float64Array
) -> xr.Dataset:
    quat = rotation.as_quat(canonical=True, scalar_first=True)
    return xr.Dataset(
        {
            "position": (("position_time", "position_component"), position, {"units": "m"}),
            "quat_wxyz": (("quat_wxyz_time", "quat_wxyz_component"), quat, {"units": "1"}),
            "covariance": (
                ("covariance_time", "row", "column"),
                covariance,
                {"long_name": "of x, y, z (m) and rotation about the fixed x, y, z (rad)"},
            ),
        },
        coords={
            f"{name}_time": (f"{name}_time", t_ns, _TIME)
            for name in ("position", "quat_wxyz", "covariance")
        },
        attrs={"Conventions": "CF-1.11", "source": "terravibe odometry", "frame": "T, z up"},
    )


def _read_netcdf(path: Path) -> Path3D:
    dataset = read_netcdf(path)
    try:
        t_ns = dataset["position_time"].values.astype(np.int64)
        position = dataset["position"].values.astype(np.float64)
        quat = dataset["quat_wxyz"].values.astype(np.float64)
        covariance = dataset["covariance"].values if "covariance" in dataset else None
        rotation = Rotation.from_quat(quat, scalar_first=True)
    except (KeyError, ValueError) as error:
        raise MappingError(
            f"{path} holds no trajectory ({what_lacks(error)}); expected position, "
            "quat_wxyz and their times"
        ) from error
    return Path3D(str(path), t_ns, position, rotation, covariance)


def _read_recording(path: Path) -> Path3D:
    """Return the recorded poses, of base_link where its place on the tracked body is known."""
    mounts, samples = MountTree(), []
    with FinishedFile(path) as source:
        for message in StreamReader(source):
            if isinstance(message.sample, StaticTransforms):
                mounts.add(message.sample.transforms)
            elif isinstance(message.sample, PoseSample):
                samples.append(message.sample)
    if not samples:
        raise MappingError(f"{path} holds no pose; give a recording with motion capture")
    to_base = RigidTransform.identity()
    if mounts.connects(MOCAP_BODY_FRAME, BASE_FRAME):
        to_base = mounts.lookup(MOCAP_BODY_FRAME, BASE_FRAME)
    newest, poses, t_ns = -1, [], []
    for sample in samples:
        if sample.t_ns > newest:
            newest = sample.t_ns
            body = RigidTransform.from_quat_wxyz(sample.position_m, sample.quat_wxyz)
            poses.append(body @ to_base)
            t_ns.append(sample.t_ns)
    rotation = Rotation.from_matrix(np.array([pose.rotation for pose in poses]))
    position = np.array([pose.translation_m for pose in poses])
    return Path3D(str(path), np.array(t_ns, np.int64), position, rotation)
