"""The commands of the rigs: arguments in, one calibration made, words out."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import NamedTuple

from acquisition.commands.console import Console
from calibration_rigs.mount_rig.command import (
    add_mount_arguments,
    add_track_arguments,
    run_mount,
    run_track,
)
from calibration_rigs.plate_rig.command import add_plate_arguments, run_plate
from calibration_rigs.static_rig.command import add_static_arguments, run_static
from calibration_rigs.static_rig.delay_command import add_delay_arguments, run_delay


class _Rig(NamedTuple):
    text: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace, Console], int]


_RIGS = {
    "plate": _Rig("depth camera, from a flat plate", add_plate_arguments, run_plate),
    "static": _Rig("gyro, accelerometer, vibration sensor", add_static_arguments, run_static),
    "delay": _Rig("yaw sensors' stamps against each other", add_delay_arguments, run_delay),
    "mount": _Rig("camera on the rover, from a flat floor", add_mount_arguments, run_mount),
    "track": _Rig("effective track of the wheels", add_track_arguments, run_track),
}


def add_calibrate_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe calibrate RIG`."""
    rigs = parser.add_subparsers(dest="rig", metavar="RIG", required=True)
    for name, rig in _RIGS.items():
        rig.add_arguments(rigs.add_parser(name, help=rig.text, description=rig.text))


def run_calibrate(options: argparse.Namespace, console: Console) -> int:
    """Run the rig that was named."""
    return _RIGS[options.rig].run(options, console)
