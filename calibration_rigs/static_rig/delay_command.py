"""`terravibe calibrate delay`: arguments in, one function called, words out."""

from __future__ import annotations

import argparse
from pathlib import Path

from acquisition.commands.arguments import milliseconds, product
from acquisition.commands.console import OK, Console, prepare_depth_code, show


def add_delay_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe calibrate delay`."""
    add = parser.add_argument
    add("recording", type=Path, metavar="REC.mcap", help="rover turned to and fro by hand")
    add(
        "-o",
        "--output",
        type=product(".toml"),
        required=True,
        metavar="FILE.toml",
        help="a block to put into rover.toml",
    )
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
    from calibration_rigs.block_file import check_block_target
    from calibration_rigs.static_rig.delay_session import DELAY_KEYS, TABLE, calibrate_delays
    from mapping.files import write_whole

    check_block_target(options.output, TABLE, DELAY_KEYS.values())
    prepare_depth_code(console)
    with console.progress(f"reading {options.recording}"):
        found = calibrate_delays(
            options.recording, options.reference, 1e-3 * options.reference_delay_ms
        )
    write_whole(options.output, found.toml().encode())
    show(console, found, as_json=options.json)
    return OK
