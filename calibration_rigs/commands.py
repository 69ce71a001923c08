"""The commands of the rigs: arguments in, one calibration made, words out."""

from __future__ import annotations

import argparse

from acquisition.commands.console import Console
from calibration_rigs.static_rig.command import add_static_arguments, run_static


def add_calibrate_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe calibrate static`."""
    rigs = parser.add_subparsers(dest="rig", metavar="RIG", required=True)
    add_static_arguments(rigs.add_parser("static", help="gyro, accelerometer, vibration sensor"))


def run_calibrate(options: argparse.Namespace, console: Console) -> int:
    """Run the rig that was named."""
    return run_static(options, console)
