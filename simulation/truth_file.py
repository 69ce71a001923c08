"""The truth of a simulated run as one NetCDF file: terrain, what was visible, poses, signals."""

from __future__ import annotations

import io
import os
import secrets
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from simulation.errors import SimulationError
from simulation.motion import STEP_NS, Motion
from simulation.terrain.height_grid import HeightGrid
from simulation.truth import Truth

Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]

_TIME = {"units": "nanoseconds since 1970-01-01", "long_name": "time of the recording"}


@dataclass(frozen=True, slots=True)
class Signal:
    """A true quantity over time.

    Attributes:
        t_ns: (N,) int64 times on the recording's clock.
        values: (N,) or (N, components).
        units: of the values, as text.
        long_name: what it is, in which frame, for people.
    """

    t_ns: Int64Array
    values: Float64Array
    units: str
    long_name: str

    def __post_init__(self) -> None:
        """Refuse values that do not belong to the times."""
        if self.t_ns.ndim != 1 or self.values.ndim not in (1, 2):
            raise SimulationError(
                f"{self.long_name}: times of shape {self.t_ns.shape} and values of shape "
                f"{self.values.shape}; expected (N,) and (N,) or (N, components)"
            )
        if self.values.shape[0] != self.t_ns.size:
            raise SimulationError(
                f"{self.long_name}: {self.values.shape[0]} values for {self.t_ns.size} times"
            )


def pose_signals(
    t_ns: Int64Array, position_m: Float64Array, quat_wxyz: Float64Array
) -> dict[str, Signal]:
    """Return the poses of the tracked body under the names of a truth file.

    Args:
        t_ns: (N,) times on the recording's clock.
        position_m: (N, 3) in the world.
        quat_wxyz: (N, 4) unit quaternions, body axes to world axes.
    """
    return {
        "position": Signal(t_ns, position_m, "m", "position of the tracked body in the world"),
        "quat_wxyz": Signal(t_ns, quat_wxyz, "1", "quaternion (w, x, y, z), body to world axes"),
    }


def motion_signals(motion: Motion) -> dict[str, Signal]:
    """Return everything that is known of a vehicle's motion, every millisecond."""
    t_ns = motion.start_ns + STEP_NS * np.arange(len(motion.position_m), dtype=np.int64)
    rest = {
        "velocity": (motion.velocity_m_s, "m s-1", "of the tracked body, world axes"),
        "body_rate": (motion.body_rate_rad_s, "rad s-1", "angular velocity, body axes"),
        "specific_force": (
            motion.acceleration_m_s2,
            "m s-2",
            "at the accelerometer, body axes, mean over the millisecond that ends there",
        ),
        "wheel_rate": (
            motion.wheel_rate_rad_s,
            "rad s-1",
            "front left, rear left, front right, rear right",
        ),
        "command": (motion.command, "1", "speed (m/s) and yaw rate (rad/s) the base was told"),
    }
    poses = pose_signals(t_ns, motion.position_m, motion.quat_wxyz)
    return poses | {name: Signal(t_ns, *what) for name, what in rest.items()}


def write_truth_file(
    path: Path,
    truth: Truth,
    ground: HeightGrid,
    signals: Mapping[str, Signal],
    facts: Mapping[str, str | float] = MappingProxyType({}),
) -> None:
    """Write a file that appears complete or not at all; equal truths give equal bytes.

    Variables: height and visible (y, x) on cells, as an evaluation reads them; ground_height
    (ground_y, ground_x), the nodes of the triangulated ground; and each signal under its name
    over NAME_time, (N,) or (N, NAME_component). The facts about the run become attributes.

    Raises:
        SimulationError: a signal has the name of something else, or the file cannot be written.
    """
    dataset = _dataset(truth, ground)
    dataset.attrs |= {f"run_{name}": fact for name, fact in facts.items()}
    for name, signal in signals.items():
        dims = (f"{name}_time", f"{name}_component")[: signal.values.ndim]
        if taken := {name, *dims} & {*dataset.variables, *dataset.dims}:
            raise SimulationError(f"a signal named {name!r}: {min(taken)!r} is taken; rename it")
        attributes = {"units": signal.units, "long_name": signal.long_name}
        dataset[name] = (dims, signal.values, attributes)
        dataset = dataset.assign_coords({dims[0]: (dims[0], signal.t_ns, _TIME)})
    _write_whole(path, _content(dataset))


def _dataset(truth: Truth, ground: HeightGrid) -> xr.Dataset:
    """Return the terrain's arrays."""
    cell = {"units": "m", "long_name": "cell centre in the terrain frame"}
    node = {"units": "m", "long_name": "node of the ground in the terrain frame"}
    height = {"units": "m", "long_name": "true height of the terrain, z up"}
    visible = {
        "units": "1",
        "long_name": "whether at least four undisturbed rays met the cell",
        "flag_values": np.array([0, 1], np.uint8),
        "flag_meanings": "hidden visible",
    }
    return xr.Dataset(
        {
            "height": (("y", "x"), truth.height_m, height),
            "visible": (("y", "x"), truth.visible.astype(np.uint8), visible),
            "ground_height": (("ground_y", "ground_x"), ground.height_m, height),
        },
        coords={
            "y": ("y", truth.y_m, cell),
            "x": ("x", truth.x_m, cell),
            "ground_y": ("ground_y", ground.y_m, node),
            "ground_x": ("ground_x", ground.x_m, node),
        },
        attrs={
            "Conventions": "CF-1.11",
            "source": "terravibe simulation",
            "frame": "terrain frame, z up",
        },
    )


def _content(dataset: xr.Dataset) -> bytes:
    encoding = {
        name: {"zlib": True, "complevel": 4, "_FillValue": None} for name in dataset.data_vars
    }
    encoding |= {name: {"_FillValue": None} for name in dataset.coords}
    buffer = io.BytesIO()
    dataset.to_netcdf(buffer, engine="h5netcdf", encoding=encoding)
    return buffer.getvalue()


def _write_whole(path: Path, content: bytes) -> None:
    """Write beside the path, synchronise, then take the name."""
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(4)}.part{path.suffix}")
    try:
        with temporary.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise SimulationError(
            f"cannot write {path}: {error.strerror}; give a file in a writable folder with "
            f"{len(content)} bytes to spare"
        ) from error
    finally:
        with suppress(OSError):
            temporary.unlink()
