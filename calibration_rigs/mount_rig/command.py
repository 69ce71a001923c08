"""`terravibe calibrate mount` and `calibrate track`: arguments in, one function called, words out.

Nothing heavy is imported before the commands run.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.commands.arguments import numbers
from acquisition.commands.console import OK, Console, prepare_depth_code, show
from calibration_rigs.rover_block import add_block_output, check_block_target, write_block

if TYPE_CHECKING:
    from acquisition.messages.codec import Recordable
    from calibration_rigs.mount_rig.camera import CameraMount

_MOST_FRAMES = 300


def add_mount_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe calibrate mount`."""
    add = parser.add_argument
    add("recording", type=Path, metavar="REC.mcap", help="rover at rest, camera sees flat floor")
    add_block_output(parser)
    add(
        "--parent-height-m",
        type=float,
        metavar="M",
        help="height above the floor of the frame that the camera is mounted in",
    )
    add("--noise", default="kinect-v1", metavar="MODEL", help="depth noise model or file")
    add("--json", action="store_true", help="print the result as JSON")


def add_track_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe calibrate track`."""
    add = parser.add_argument
    add("recording", type=Path, metavar="REC.mcap", help="turns on the spot, rests between")
    add(
        "--turns-deg",
        type=numbers(None, "angles in degrees"),
        required=True,
        metavar="A,B,...",
        help="their angles, counter-clockwise positive; --turns-deg=-A,... where the first is "
        "negative",
    )
    add("--json", action="store_true", help="print the result as JSON")


def run_mount(options: argparse.Namespace, console: Console) -> int:
    """Write the block for rover.toml."""
    from calibration_rigs.mount_rig.camera import MOUNT_KEYS, TABLE

    check_block_target(options.output, TABLE, MOUNT_KEYS)
    prepare_depth_code(console)
    with console.progress(f"reading {options.recording}"):
        samples = _samples(options.recording)
    write_block(options, console, _camera_mount(options, samples))
    return OK


def run_track(options: argparse.Namespace, console: Console) -> int:
    """Print the effective track."""
    from calibration_rigs.mount_rig.track import calibrate_track
    from drivers.samples import WheelTwistSample, YawRateSample

    prepare_depth_code(console)
    with console.progress(f"reading {options.recording}"):
        samples = _samples(options.recording)
    twists = [sample for sample in samples if isinstance(sample, WheelTwistSample)]
    track = calibrate_track(
        twists,
        [math.radians(angle) for angle in options.turns_deg],
        gyro=[sample for sample in samples if isinstance(sample, YawRateSample)],
    )
    show(console, track, as_json=options.json)
    return OK


def _camera_mount(options: argparse.Namespace, samples: list[Recordable]) -> CameraMount:
    """Return the mount that the frames tell, from the recorded one, which is about right."""
    from acquisition.messages.frames import DEPTH_OPTICAL_FRAME, StaticTransforms
    from calibration_rigs.errors import RigError
    from calibration_rigs.mount_rig.camera import calibrate_camera
    from drivers.samples import DepthFrame
    from mapping.calibration_file import noise_from_name
    from mapping.mounts import MountTree

    tree, parents = MountTree(), []
    for sample in samples:
        if isinstance(sample, StaticTransforms):
            tree.add(sample.transforms)
            found = [t for t in sample.transforms if t.child_frame == DEPTH_OPTICAL_FRAME]
            parents += [item.parent_frame for item in found]
    if not parents:
        raise RigError(
            f"{options.recording} has no mount of {DEPTH_OPTICAL_FRAME}; expected one that is "
            "about right: give [mounts] in rover.toml and record again"
        )
    frames = [sample for sample in samples if isinstance(sample, DepthFrame)]
    return calibrate_camera(
        frames[:_MOST_FRAMES],
        tree.lookup(parents[-1], DEPTH_OPTICAL_FRAME),
        parents[-1],
        noise_from_name(options.noise),
        options.parent_height_m,
    )


def _samples(path: Path) -> list[Recordable]:
    """Return depth frames, mounts, wheel speeds and yaw rates of a recording."""
    from acquisition.messages.frames import StaticTransforms
    from acquisition.stream.byte_source import FinishedFile
    from acquisition.stream.reader import StreamReader
    from calibration_rigs.errors import RigError
    from drivers.samples import DepthFrame, WheelTwistSample, YawRateSample

    kept: list[Recordable] = []
    frames = 0
    with FinishedFile(path) as source:
        reader = StreamReader(source)
        for message in reader:
            sample = message.sample
            frames += isinstance(sample, DepthFrame)
            if isinstance(sample, DepthFrame) and frames > _MOST_FRAMES:
                continue
            if isinstance(sample, StaticTransforms | DepthFrame | WheelTwistSample | YawRateSample):
                kept.append(sample)
        if reader.report.damaged:
            raise RigError(
                f"{path} is damaged in {len(reader.report.damaged)} places; a calibration needs "
                "it whole: run `terravibe recover`, and use what that gives"
            )
    return kept
