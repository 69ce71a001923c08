"""The command that finds the rover's way: arguments in, one function called, words out.

Nothing heavy is imported before the command runs.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from acquisition.commands.console import CHECK_FAILED, OK, Console, prepare_depth_code, show


def add_odometry_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe odometry`."""
    add = parser.add_argument
    add("recording", type=Path, help="of accelerations or vibration, yaw rates, wheels")
    add(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="EST",
        help=".nc with covariances, else a TUM file",
    )
    add(
        "--method",
        choices=("filter", "paper2019"),
        default="filter",
        help="paper2019: as printed, to compare (filter)",
    )
    add("--rate-hz", type=float, default=50.0, metavar="HZ", help="poses per second (50)")
    add("--without-wheels", action="store_true", help="vibration and gyro alone")
    add("--with-poses", action="store_true", help="recorded poses count as measurements")
    add(
        "--calibrations", type=Path, metavar="DIR", help="take the files of the recording's sensors"
    )
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="a setting of ego-motion")
    add("--json", action="store_true", help="print the result as JSON")


def run_odometry(options: argparse.Namespace, console: Console) -> int:
    """Find the trajectory of a recording and write it; 1 when parts of it were damaged."""
    from acquisition.files import check_target, refuse_same_file
    from acquisition.stream.byte_source import FinishedFile
    from acquisition.stream.reader import StreamReader
    from mapping.ego_motion.paper2019 import WARNING
    from mapping.ego_motion.settings import EgoMotionSettings
    from mapping.errors import MappingError
    from mapping.judging.trajectory import write_path
    from mapping.odometry_session import find_trajectory, with_changes
    from mapping.output.trajectory_summary import summarise_trajectory

    changes = [*options.set, *(["use_external_poses=1"] if options.with_poses else [])]
    settings = with_changes(EgoMotionSettings(), changes)  # refuse them before the long work
    check_target(options.output)
    refuse_same_file(options.recording, options.output)
    if options.output.suffix == ".mcap":
        raise MappingError(
            f"found {options.output}, expected .nc, or another name for a TUM file; `terravibe map "
            "--trajectory` writes poses as .mcap"
        )
    with FinishedFile(options.recording) as source:
        if options.method == "filter":
            _prepare_filter(console)
        prepare_depth_code(console)
        if options.method == "paper2019":
            console.note(f"warning: {WARNING}")
        reader = StreamReader(source)
        with console.progress(f"following {options.recording}"):
            result = find_trajectory(
                reader,
                settings,
                method=options.method,
                rate_hz=options.rate_hz,
                with_wheels=not options.without_wheels,
                calibrations=options.calibrations,
                changes=changes,
            )
    write_path(options.output, result.poses)
    report = reader.report
    summary = summarise_trajectory(result, str(options.output), report.losses())
    show(console, summary, as_json=options.json)
    if options.method == "filter":
        for note in result.inertial.notes:
            console.note(note)
    for warning in summary.warnings:
        console.note(f"warning: {warning}")
    for event in summary.events:
        console.note(event.describe())
    return CHECK_FAILED if report.damaged else OK


def _prepare_filter(console: Console) -> None:
    """Compile the kernel of ego-motion if this installation never did, and say so."""
    from mapping.kernel_cache import compile_filter, filter_is_cached

    if not filter_is_cached():
        console.note("compiling the filter of ego-motion; once per installation, takes about 20 s")
    compile_filter()
