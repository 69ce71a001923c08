"""`terravibe calibrate static`: arguments in, calibrations made and joined, words out.

Nothing heavy is imported before the command runs.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.commands.arguments import numbers, product
from acquisition.commands.console import OK, Console, prepare_depth_code, show

if TYPE_CHECKING:
    from calibration_rigs.static_rig.session import StaticCalibration

_STANDARD_GRAVITY_M_S2 = 9.80665


def add_static_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe calibrate static`."""
    add = parser.add_argument
    add("--rest", type=Path, metavar="REC.mcap", help="nothing moves, two to three hours")
    add("--attitudes", type=Path, metavar="REC.mcap", help="rests on all six sides or more")
    add(
        "--gravity-m-s2",
        type=float,
        default=_STANDARD_GRAVITY_M_S2,
        metavar="G",
        help="where the attitudes were recorded (9.80665)",
    )
    add("--turns", type=Path, metavar="REC.mcap", help="turns by known angles, rests between")
    add(
        "--turns-deg",
        type=numbers(None, "angles in degrees"),
        metavar="A,B,...",
        help="the angles of --turns, counter-clockwise positive; --turns-deg=-A,... where the "
        "first is negative",
    )
    add("--shaker", type=Path, metavar="TABLE.csv", help="sensor beside reference, by frequency")
    add("--model", default="", metavar="NAME", help="of the device")
    add("--serial", default="", metavar="NUMBER", help="of the device")
    add("-o", "--output", type=product(".json"), required=True, metavar="FILE.json")
    add("--figure", type=product(".png"), metavar="FILE.png", help="draw the Allan deviations")
    add(
        "--deviations",
        type=product(".csv"),
        metavar="FILE.csv",
        help="write adev, oadev, mdev, hdev and tdev of every signal at rest",
    )
    add("--json", action="store_true", help="print the calibration as JSON")


def run_static(options: argparse.Namespace, console: Console) -> int:
    """Make the calibrations that recordings were given for, join them, write one file."""
    from calibration_rigs.static_rig.session import join
    from mapping.calibration_file import DeviceIdentity
    from mapping.files import write_whole

    _check_targets(options)
    prepare_depth_code(console)
    result = join(_parts(options, console))
    device = DeviceIdentity(model=options.model, serial=options.serial)
    result.file = result.file.model_copy(update={"device": device})
    if options.figure is not None:
        from calibration_rigs.static_rig.figure import draw_curves

        draw_curves(result.curves, options.figure)
    if options.deviations is not None:
        from calibration_rigs.static_rig.deviations import deviations_csv

        write_whole(options.deviations, deviations_csv(result.at_rest).encode())
    write_whole(options.output, result.file.to_json().encode())
    show(console, result, as_json=options.json)
    return OK


def _check_targets(options: argparse.Namespace) -> None:
    """Refuse what cannot be written, or not be filled, before hours of recordings are read."""
    from acquisition.files import check_target, refuse_same_file
    from calibration_rigs.errors import RigError
    from calibration_rigs.replaced import check_replaced, of_schema, of_table
    from calibration_rigs.static_rig.deviations import COLUMNS
    from mapping.inertial_calibration import INERTIAL_SCHEMA

    check_replaced(options.output, "inertial calibration", of_schema(INERTIAL_SCHEMA))
    if options.figure is not None:
        check_target(options.figure)
    if options.deviations is not None:
        check_replaced(options.deviations, "table of deviations", of_table(COLUMNS))
    for option in ("figure", "deviations"):
        if getattr(options, option) is not None and options.rest is None:
            raise RigError(f"--{option} is of signals at rest; give --rest REC.mcap, or leave it")
    if options.shaker is not None and options.deviations is not None:
        refuse_same_file(options.shaker, options.deviations)


def _parts(options: argparse.Namespace, console: Console) -> list[StaticCalibration]:
    from calibration_rigs.errors import RigError
    from calibration_rigs.static_rig import session
    from calibration_rigs.static_rig.signals import read_signals

    if (options.turns is None) != (options.turns_deg is None):
        raise RigError("--turns and --turns-deg go together; give both or none")
    parts = []
    if options.rest is not None:
        with console.progress(f"reading {options.rest}") as reached:
            signals = read_signals(options.rest, reached)
        parts.append(session.calibrate_rest(signals))
    if options.attitudes is not None:
        with console.progress(f"reading {options.attitudes}") as reached:
            signals = read_signals(options.attitudes, reached)
        parts.append(session.calibrate_attitudes(signals, options.gravity_m_s2))
    if options.turns is not None:
        with console.progress(f"reading {options.turns}") as reached:
            signals = read_signals(options.turns, reached)
        true_rad = [math.radians(angle) for angle in options.turns_deg]
        parts.append(session.calibrate_turns(signals, true_rad))
    if options.shaker is not None:
        parts.append(session.calibrate_shaker(options.shaker))
    if not parts:
        raise RigError("nothing to calibrate; give --rest, --attitudes, --turns or --shaker")
    return parts
