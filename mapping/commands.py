"""The commands that make and look at maps: arguments in, one function called, words out.

Nothing heavy is imported before a command runs.
"""

from __future__ import annotations

import argparse
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from math import inf, radians
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from acquisition.commands.arguments import product, seconds
from acquisition.commands.console import (
    CHECK_FAILED,
    OK,
    Console,
    prepare_depth_code,
    show,
)
from mapping.poses.settings import PoseSourceName, TiltSource

if TYPE_CHECKING:
    from acquisition.stream.byte_source import ByteSource
    from acquisition.stream.reader import StreamMessage
    from mapping.session import MapOptions


def add_info_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe info`."""
    parser.add_argument("file", type=Path, help="a recording, a map's .nc or a world's .zarr")
    parser.add_argument("--json", action="store_true", help="everything, as JSON")


def run_info(options: argparse.Namespace, console: Console) -> int:
    """Say what a recording, a map or a world holds."""
    if options.file.is_dir() or options.file.suffix in (".nc", ".zarr"):
        from mapping.output.map_file import read_map
        from mapping.output.map_summary import summarise
        from mapping.world.world_map import is_world, read_world

        map_ = read_world(options.file) if is_world(options.file) else read_map(options.file)
        show(console, summarise(map_), as_json=options.json)
    else:
        from acquisition.inspection import inspect

        show(console, inspect(options.file), as_json=options.json)
    return OK


def add_map_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe map`; options left out keep the recording's values or the defaults."""
    add = parser.add_argument
    add("recording", help="MCAP file, or - for standard input")
    add(
        "-o",
        "--output",
        type=product(".nc"),
        metavar="FILE.nc",
        help="required without --world",
    )
    add("--follow", action="store_true", help="map a file that is still being written")
    add(
        "--idle-timeout-s",
        type=seconds,
        metavar="S",
        help="with --follow: end after so long a silence (never)",
    )
    add(
        "--reorder-window-s",
        type=seconds,
        default=0.5,
        metavar="S",
        help="how late a message may be (0.5)",
    )
    add("--resolution", dest="resolution_m", type=float, metavar="M", help="cell size (0.04)")
    add("--grid", choices=("growing", "scrolling"), help="keep everything (growing), or a window")
    add("--window-m", type=float, metavar="M", help="edge of that window (6; of a world 12)")
    add("--world", type=Path, metavar="DIR.zarr", help="keep on disk what leaves the window")
    add("--continue", dest="continue_world", action="store_true", help="add to that world")
    add("--method", choices=("corrected", "paper2019"), help="paper2019: as printed, to compare")
    add("--noise", metavar="MODEL", help="preset, constant:SIGMA_M, or a calibration file")
    add("--undistortion", type=Path, metavar="FILE.npz", help="take this off every pixel")
    add("--calibrations", type=Path, metavar="DIR", help="take the file of the recording's device")
    add("--range-min-m", type=float, metavar="M", help="nearest depth that is mapped (0.4)")
    add("--range-max-m", type=float, metavar="M", help="farthest depth that is mapped (4)")
    add("--mount-sigma-m", type=float, metavar="M", help="overrides the recording's value")
    add("--mount-sigma-deg", type=float, metavar="DEG", help="overrides the recording's value")
    add("--gate-sigma", type=float, metavar="N", help="reject beyond N sigma (3.5)")
    add("--common-correlation-time-s", type=float, metavar="S", help="of pose errors (0.3)")
    add("--pose-gap-max-s", type=float, metavar="S", help="longest pose interpolation (0.2)")
    sources = get_args(PoseSourceName)
    add("--pose-source", choices=sources, metavar="SOURCE", help=f"{', '.join(sources)} (mocap)")
    add("--tilt-source", choices=get_args(TiltSource), help="of ego-motion (levelled)")
    add("--trajectory", type=Path, metavar="FILE", help="also write the poses: .mcap, .nc or TUM")
    add("--fill-gaps-up-to-m", type=float, metavar="M", help="fill gaps up to this long (none)")
    add("--figures", type=Path, metavar="DIR", help="also draw the figures")
    add("--json", action="store_true", help="print the result as JSON")


def run_map(options: argparse.Namespace, console: Console) -> int:
    """Turn a recording into an elevation map; 1 when parts of it were damaged."""
    from acquisition.stream.reader import StreamReader
    from mapping.ground.fill import fill_gaps, gap_cells
    from mapping.output.commands import draw
    from mapping.output.map_file import write_map
    from mapping.output.map_summary import summarise_run
    from mapping.output.odometry_file import write_trajectory
    from mapping.paper2019.faults import describe_faults
    from mapping.session import map_stream

    map_options = _map_options(options)
    gap_m = options.fill_gaps_up_to_m
    if gap_m is not None:
        gap_cells(gap_m, map_options.settings.resolution_m)  # refuse it before the long work
    _check_targets(options)
    _tell_of_other_parts(options.recording, console)
    with _byte_source(options) as source:
        prepare_depth_code(console)
        reader = StreamReader(source, reorder_window_ns=round(options.reorder_window_s * 1e9))
        with console.progress(f"mapping {options.recording}") as reached:
            prepare = partial(prepare_kernels, console)
            result = map_stream(reader, map_options, frame_counter(reached), prepare)
    if gap_m is not None:
        result = replace(result, map=fill_gaps(result.map, gap_m))
    if options.output:
        write_map(result.map, options.output)
    if options.trajectory:
        write_trajectory(options.trajectory, result.poses, result.body_frame)
    summary = summarise_run(result, str(options.output or options.world))
    drawable = summary.map.height_m is not None
    if options.figures and drawable:
        draw(result.map, options.figures, console)
    show(console, summary, as_json=options.json)
    if options.figures and not drawable:
        console.note(f"nothing is drawn into {options.figures}: no cell of the map is confirmed")
    if options.method == "paper2019":
        console.note(describe_faults())
    if result.inertial is not None:
        for note in result.inertial.notes:
            console.note(note)
    for warning in summary.warnings:
        console.note(f"warning: {warning}")
    return CHECK_FAILED if result.report.damaged else OK


def _check_targets(options: argparse.Namespace) -> None:
    """Refuse what cannot be written, and what would do nothing, before the long work."""
    from acquisition.files import check_folder, check_target, refuse_same_file
    from mapping.errors import MappingError

    if not options.output and not options.world:
        raise MappingError("nothing to write; give -o FILE.nc, --world DIR.zarr, or both")
    targets = [target for target in (options.output, options.trajectory) if target]
    for target in targets:
        check_target(target)
        refuse_same_file(Path(options.recording), target)
    if len(targets) == 2:
        refuse_same_file(*targets)
    if options.figures:
        check_folder(options.figures)
    if options.idle_timeout_s is not None and not options.follow:
        raise MappingError("--idle-timeout-s is for --follow; give both or none")
    if options.noise and options.calibrations:
        raise MappingError("--noise and --calibrations both say the noise; give one of them")
    if options.world and options.grid == "growing":
        raise MappingError("a world is mapped through a scrolling window; leave --grid out")
    if options.world and options.method == "paper2019":
        raise MappingError("paper2019 has no window over a world; leave --world out")
    if options.undistortion and options.method == "paper2019":
        raise MappingError("paper2019 takes readings as they are; leave --undistortion out")
    if options.continue_world and not options.world:
        raise MappingError("--continue adds to a world; give --world DIR.zarr too")


def _tell_of_other_parts(recording: str, console: Console) -> None:
    """Say that a recording goes on in further parts, which are recordings of their own."""
    from acquisition.stream.parts import parts_of

    path = Path(recording)
    others = [part for part in parts_of(path) if part != path] if path.is_file() else []
    if others:
        console.note(
            f"warning: {recording} goes on in {', '.join(part.name for part in others)}, which is "
            "not mapped; `terravibe merge` makes one recording of them"
        )


def _map_options(options: argparse.Namespace) -> MapOptions:
    """Return what the user asked for."""
    from drivers.checks import check_not_negative
    from mapping.calibration_file import calibration_from_name
    from mapping.session import MapOptions
    from mapping.settings import MapSettings
    from mapping.undistortion import read_undistortion

    names = MapSettings.__dataclass_fields__.keys() - {"mount_sigma_m"}
    given = {
        name: value for name, value in vars(options).items() if name in names and value is not None
    }
    defaults: dict[str, float] = {}
    if options.world:
        given["grid"] = "scrolling"
        defaults["window_m"] = 12.0
    degrees = options.mount_sigma_deg
    if degrees is not None:
        check_not_negative("--mount-sigma-deg", degrees)  # else it would be told in radians
    return MapOptions(
        settings=MapSettings(**(defaults | given)),
        given=frozenset(given),
        noise=calibration_from_name(options.noise) if options.noise else None,
        calibrations=options.calibrations,
        undistortion=read_undistortion(options.undistortion) if options.undistortion else None,
        mount_sigma_m=options.mount_sigma_m,
        mount_sigma_rad=None if degrees is None else radians(degrees),
        world=options.world,
        continue_world=options.continue_world,
        method=options.method or "corrected",
    )


@contextmanager
def _byte_source(options: argparse.Namespace) -> Iterator[ByteSource]:
    """Open the recording."""
    from acquisition.stream.byte_source import FinishedFile, GrowingFile, standard_input

    if options.recording == "-":
        yield standard_input()
    elif not options.follow:
        with FinishedFile(Path(options.recording)) as finished:
            yield finished
    else:
        with (
            _interrupt_as_stop() as stop,
            GrowingFile(
                Path(options.recording),
                idle_timeout_s=inf if options.idle_timeout_s is None else options.idle_timeout_s,
                stop=stop,
            ) as growing,
        ):
            yield growing


@contextmanager
def _interrupt_as_stop() -> Iterator[Callable[[], bool]]:
    """Let Ctrl-C end a followed stream, so that what was seen becomes a map."""
    stopped = False

    def stop(*_: object) -> None:
        """Take note; the next look ends the mapping."""
        nonlocal stopped
        stopped = True

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield lambda: stopped
    finally:
        signal.signal(signal.SIGINT, before)


def frame_counter(reached: Callable[[str], None]) -> Callable[[StreamMessage], None]:
    """Return a function that counts the depth frames among messages and tells `reached`."""
    from drivers.samples import DepthFrame

    frames = 0

    def count(message: StreamMessage) -> None:
        nonlocal frames
        if isinstance(message.sample, DepthFrame):
            frames += 1
            reached(f"{frames} depth frames")

    return count


def prepare_kernels(console: Console) -> None:
    """Compile the kernels if this installation never did, and say so."""
    from mapping.kernel_cache import compile_kernels, kernels_are_cached

    if not kernels_are_cached():
        console.note("compiling the mapping kernels; once per installation, takes about 20 s")
    compile_kernels()


def add_warmup_arguments(_: argparse.ArgumentParser) -> None:
    """Declare `terravibe warmup`, which has none."""


def run_warmup(_: argparse.Namespace, console: Console) -> int:
    """Compile the kernels now, not at the first frame."""
    prepare_kernels(console)
    prepare_depth_code(console)
    console.lines(["the mapping kernels and the code for depth images are compiled and cached"])
    return OK
