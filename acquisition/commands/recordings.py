"""The commands that make and look at recordings: arguments in, one function called, words out.

Nothing heavy is imported before a command runs.
"""

from __future__ import annotations

import argparse
from math import radians
from pathlib import Path

from acquisition.commands.arguments import numbers, product
from acquisition.commands.console import CHECK_FAILED, OK, Console, show


def add_import_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe import tum|png`."""
    kinds = parser.add_subparsers(dest="kind", metavar="KIND", required=True)
    tum = kinds.add_parser("tum", help="a folder in the TUM RGB-D layout")
    tum.add_argument(
        "--depth-scale",
        type=float,
        default=5000.0,
        metavar="COUNTS_PER_M",
        help="of the images (5000)",
    )
    tum.add_argument("--no-poses", action="store_true", help="do not read groundtruth.txt")
    png = kinds.add_parser("png", help="a folder of 16-bit PNG images in millimetres")
    png.add_argument("--poses", type=Path, metavar="FILE", help="trajectory in TUM format")
    png.add_argument("--rate-hz", type=float, metavar="HZ", help="when the names are numbers")
    for kind in (tum, png):
        _add_common_import_arguments(kind)


def _add_common_import_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("folder", type=Path, help="where the images are")
    add("-o", "--output", type=product(".mcap"), required=True, metavar="FILE.mcap")
    add(
        "--intrinsics",
        type=numbers(4, "fx,fy,cx,cy in pixels"),
        required=True,
        metavar="FX,FY,CX,CY",
        help="pinhole intrinsics of the depth camera in pixels",
    )
    add("--pose-sigma-m", type=float, metavar="M", help="1 sigma of each coordinate (0.005)")
    add("--pose-sigma-deg", type=float, metavar="DEG", help="1 sigma of the rotation (0.25)")
    add("--max-pose-gap-s", type=float, metavar="S", help="longest pose interpolation (0.1)")
    add(
        "--frames-without-pose",
        choices=("refuse", "keep"),
        help="what to do with a depth image that the poses do not cover (refuse)",
    )
    add(
        "--mount-sigma-m",
        type=float,
        default=0.005,
        metavar="M",
        help="1 sigma of the camera's place on the tracked body (0.005)",
    )
    add(
        "--mount-sigma-deg",
        type=float,
        default=0.5,
        metavar="DEG",
        help="1 sigma of the camera's rotation on the tracked body (0.5)",
    )
    add("--json", action="store_true", help="print what was imported as JSON")


def run_import(options: argparse.Namespace, console: Console) -> int:
    """Turn a folder of depth images into a recording."""
    from acquisition.importing import record_all
    from acquisition.messages.frames import camera_is_tracked_body
    from drivers.checks import check_not_negative, check_positive
    from drivers.source import make_source

    check_not_negative("--mount-sigma-m", options.mount_sigma_m)
    check_not_negative("--mount-sigma-deg", options.mount_sigma_deg)
    for option in ("pose_sigma_m", "pose_sigma_deg", "max_pose_gap_s"):
        if (value := getattr(options, option)) is not None:
            check_positive(f"--{option.replace('_', '-')}", value)
    source = make_source(
        options.kind,
        folder=options.folder,
        intrinsics_px=options.intrinsics,
        **_source_settings(options),
    )
    with console.progress(f"importing {options.folder}") as reached:
        summary = record_all(
            source,
            options.output,
            static_transforms=[camera_is_tracked_body()],
            settings={
                "mount_sigma_m": options.mount_sigma_m,
                "mount_sigma_rad": radians(options.mount_sigma_deg),
            },
            progress=lambda samples: reached(f"{samples} samples"),
        )
    show(console, summary, as_json=options.json)
    return OK


def _source_settings(options: argparse.Namespace) -> dict[str, object]:
    """Return the settings of the source that the user gave; the others keep their defaults."""
    settings: dict[str, object] = {
        "pose_sigma_m": options.pose_sigma_m,
        "pose_sigma_rad": _radians(options.pose_sigma_deg),
        "max_pose_gap_s": options.max_pose_gap_s,
        "frames_without_pose": options.frames_without_pose,
    }
    if options.kind == "tum":
        settings |= {"depth_scale": options.depth_scale, "with_poses": not options.no_poses}
    else:
        settings |= {"poses": options.poses, "rate_hz": options.rate_hz}
    return {name: value for name, value in settings.items() if value is not None}


def _radians(degrees: float | None) -> float | None:
    return None if degrees is None else radians(degrees)


def add_check_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe check`."""
    parser.epilog = "Exits with 1 when anything was found."
    parser.add_argument("file", type=Path, help="a recording")
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")


def run_check(options: argparse.Namespace, console: Console) -> int:
    """Look for damage, gaps and missing parts; 1 when there are any."""
    from dataclasses import asdict

    from acquisition.inspection import check

    findings = check(options.file)
    if options.json:
        console.json({"findings": [asdict(finding) for finding in findings]})
    elif findings:
        console.lines(finding.describe() for finding in findings)
    else:
        console.lines([f"{options.file}: nothing wrong found"])
    return CHECK_FAILED if findings else OK
