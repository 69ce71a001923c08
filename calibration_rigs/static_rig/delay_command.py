"""`terravibe calibrate delay`: arguments in, one function called, words out."""

from __future__ import annotations

import argparse
from pathlib import Path

from acquisition.commands.arguments import milliseconds
from acquisition.commands.console import OK, Console, prepare_depth_code
from calibration_rigs.rover_block import add_block_output, check_block_target, write_block


def add_delay_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe calibrate delay`."""
    add = parser.add_argument
    add("recording", type=Path, metavar="REC.mcap", help="rover turned to and fro by hand")
    add_block_output(parser)
    add(
        "--reference",
        choices=("mocap", "gyro", "wheels"),
        help="whose stamps the others are held against (the first of these that was recorded)",
    )
    add(
        "--reference-delay-ms",
        type=milliseconds,
        default=0.0,
        metavar="MS",
        help="by how much the reference's own stamps are late (0)",
    )
    add("--json", action="store_true", help="print the result as JSON")


def run_delay(options: argparse.Namespace, console: Console) -> int:
    """Write the block for rover.toml."""
    from calibration_rigs.static_rig.delay_session import DELAY_KEYS, TABLE, calibrate_delays

    check_block_target(options.output, TABLE, DELAY_KEYS.values())
    prepare_depth_code(console)
    with console.progress(f"reading {options.recording}"):
        found = calibrate_delays(
            options.recording, options.reference, 1e-3 * options.reference_delay_ms
        )
    write_block(options, console, found)
    return OK
