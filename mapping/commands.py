"""The commands that make and look at maps: arguments in, one function called, words out.

Nothing heavy is imported before a command runs.
"""

from __future__ import annotations

import argparse
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from math import inf, radians
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from acquisition.commands.console import CHECK_FAILED, OK, Console, show
from mapping.poses.settings import PoseSourceName, TiltSource

if TYPE_CHECKING:
    from acquisition.stream.byte_source import ByteSource
    from acquisition.stream.reader import StreamMessage
    from mapping.cells.elevation_map import ElevationMap
    from mapping.judging.evaluation import Scores
    from mapping.judging.floor_evaluation import FloorScores
    from mapping.session import MapOptions


def add_info_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe info`."""
    parser.add_argument("file", type=Path)
    parser.add_argument("--json", action="store_true")


def run_info(options: argparse.Namespace, console: Console) -> int:
    """Say what a recording, a map or a world holds."""
    is_world = (options.file / "zarr.json").exists()
    if is_world or options.file.suffix == ".nc":
        from mapping.output.map_file import read_map
        from mapping.output.map_summary import summarise
        from mapping.world.world_map import read_world

        map_ = read_world(options.file) if is_world else read_map(options.file)
        show(console, summarise(map_), as_json=options.json)
    else:
        from acquisition.inspection import inspect

        show(console, inspect(options.file), as_json=options.json)
    return OK


def add_map_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe map`; options left out keep the recording's values or the defaults."""
    add = parser.add_argument
    add("recording", help="MCAP file, or - for standard input")
    add("-o", "--output", type=Path, metavar="FILE.nc", help="required without --world")
    add("--follow", action="store_true", help="map a file that is still being written")
    add("--idle-timeout-s", type=float, default=inf, metavar="S", help="with --follow: give up")
    add(
        "--reorder-window-s", type=float, default=0.5, metavar="S", help="how late a message may be"
    )
    add("--resolution", dest="resolution_m", type=float, metavar="M", help="cell size (0.04)")
    add("--grid", choices=("growing", "scrolling"), help="keep everything, or a window")
    add("--window-m", type=float, metavar="M", help="edge of that window (6; of a world 12)")
    add("--world", type=Path, metavar="DIR.zarr", help="keep on disk what leaves the window")
    add("--continue", dest="continue_world", action="store_true", help="add to that world")
    add("--method", choices=("corrected", "paper2019"), help="or the paper's printed equations")
    add("--noise", metavar="MODEL", help="preset, constant:SIGMA_M, or a calibration file")
    add("--calibrations", type=Path, metavar="DIR", help="take the file of the recording's device")
    add("--range-min-m", type=float, metavar="M", help="nearest depth that is mapped (0.4)")
    add("--range-max-m", type=float, metavar="M", help="farthest depth that is mapped (4)")
    add("--mount-sigma-m", type=float, metavar="M", help="overrides the recording's value")
    add("--mount-sigma-deg", type=float, metavar="DEG", help="overrides the recording's value")
    add("--gate-sigma", type=float, metavar="N", help="reject beyond N sigma (3.5)")
    add("--common-correlation-time-s", type=float, metavar="S", help="of pose errors (0.3)")
    add("--pose-gap-max-s", type=float, metavar="S", help="longest pose interpolation (0.2)")
    add("--pose-source", choices=get_args(PoseSourceName), help="where poses come from (mocap)")
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
    with _byte_source(options) as source:
        prepare_kernels(console)
        reader = StreamReader(source, reorder_window_ns=round(options.reorder_window_s * 1e9))
        with console.progress(f"mapping {options.recording}") as reached:
            result = map_stream(reader, map_options, frame_counter(reached))
    if gap_m is not None:
        result = replace(result, map=fill_gaps(result.map, gap_m))
    if options.output:
        write_map(result.map, options.output)
    if options.trajectory:
        write_trajectory(options.trajectory, result.poses, result.body_frame)
    if options.figures:
        draw(result.map, options.figures, console)
    summary = summarise_run(result, str(options.output or options.world))
    show(console, summary, as_json=options.json)
    if options.method == "paper2019":
        console.note(describe_faults())
    if result.inertial is not None:
        for note in result.inertial.notes:
            console.note(note)
    for warning in summary.warnings:
        console.note(f"warning: {warning}")
    return CHECK_FAILED if result.report.damaged else OK


def _check_targets(options: argparse.Namespace) -> None:
    """Refuse what cannot be written before the long work."""
    from acquisition.files import check_target
    from mapping.errors import MappingError

    if options.output:
        check_target(options.output)
    elif not options.world:
        raise MappingError("nothing to write; give -o FILE.nc, --world DIR.zarr, or both")
    if options.trajectory:
        check_target(options.trajectory)
    if options.world and options.grid == "growing":
        raise MappingError("a world is mapped through a scrolling window; leave --grid out")
    if options.world and options.method == "paper2019":
        raise MappingError("paper2019 has no window over a world; leave --world out")
    if options.continue_world and not options.world:
        raise MappingError("--continue adds to a world; give --world DIR.zarr too")


def _map_options(options: argparse.Namespace) -> MapOptions:
    """Return what the user asked for."""
    from mapping.calibration_file import calibration_from_name
    from mapping.session import MapOptions
    from mapping.settings import MapSettings

    names = MapSettings.__dataclass_fields__.keys() - {"mount_sigma_m"}
    given = {
        name: value for name, value in vars(options).items() if name in names and value is not None
    }
    defaults: dict[str, float] = {}
    if options.world:
        given["grid"] = "scrolling"
        defaults["window_m"] = 12.0
    degrees = options.mount_sigma_deg
    return MapOptions(
        settings=MapSettings(**(defaults | given)),
        given=frozenset(given),
        noise=calibration_from_name(options.noise) if options.noise else None,
        calibrations=options.calibrations,
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
                Path(options.recording), idle_timeout_s=options.idle_timeout_s, stop=stop
            ) as growing,
        ):
            yield growing


@contextmanager
def _interrupt_as_stop() -> Iterator[Callable[[], bool]]:
    """Let Ctrl-C end a followed stream, so that what was seen becomes a map."""
    stopped = False

    def stop(*_: object) -> None:
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


def prepare_filter(console: Console) -> None:
    """Compile the kernel of ego-motion if this installation never did, and say so."""
    from mapping.kernel_cache import compile_filter, filter_is_cached

    if not filter_is_cached():
        console.note("compiling the filter of ego-motion; once per installation, takes about 20 s")
    compile_filter()


def add_warmup_arguments(_: argparse.ArgumentParser) -> None:
    """Declare `terravibe warmup`, which has none."""


def run_warmup(_: argparse.Namespace, console: Console) -> int:
    """Compile the kernels now, not at the first frame."""
    prepare_kernels(console)
    console.lines(["the mapping kernels are compiled and cached"])
    return OK


def add_evaluate_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe evaluate`."""
    from mapping.odometry_commands import add_comparison_arguments

    parser.add_argument(
        "subject", nargs="+", metavar="MAP | odometry EST TRUTH", help="a map, or two trajectories"
    )
    judge = parser.add_mutually_exclusive_group()
    judge.add_argument("--truth", type=Path, metavar="FILE.nc", help="true heights")
    judge.add_argument("--floor-height-m", type=float, metavar="M", help="height of a flat floor")
    parser.add_argument("--box", type=Path, metavar="FILE", help="a box that stands on the floor")
    parser.add_argument(
        "--trajectory",
        type=Path,
        metavar="FILE.txt",
        help="with --truth: the poses that the map was made with, where they are not the true ones",
    )
    parser.add_argument("--figures", type=Path, metavar="DIR", help="draw into DIR")
    parser.add_argument("--json", action="store_true")
    add_comparison_arguments(parser)


def run_evaluate(options: argparse.Namespace, console: Console) -> int:
    """Compare a map with the truth or with a flat floor, or two trajectories."""
    from mapping.errors import MappingError
    from mapping.judging.floor_evaluation import evaluate_floor, read_box
    from mapping.odometry_commands import compare_trajectories
    from mapping.output.map_file import read_map

    if options.subject[0] == "odometry":
        return compare_trajectories(options, console)
    if len(options.subject) != 1 or (options.truth is None and options.floor_height_m is None):
        raise MappingError(
            "give one map with --truth FILE.nc or --floor-height-m M, or odometry EST TRUTH"
        )
    map_ = read_map(Path(options.subject[0]))
    scores: Scores | FloorScores
    if options.truth:
        scores = _evaluate_truth(map_, options, console)
    elif options.trajectory or options.figures:
        raise MappingError("--trajectory and --figures need --truth; a flat floor has neither")
    else:
        box = read_box(options.box) if options.box else None
        scores = evaluate_floor(map_, options.floor_height_m, box)
    if options.json:
        console.json(scores.as_json())
    else:
        console.lines(scores.lines())
    return OK


def _evaluate_truth(map_: ElevationMap, options: argparse.Namespace, console: Console) -> Scores:
    from drivers.depth.trajectory import read_trajectory
    from mapping.judging.truth import evaluate_truth, read_truth
    from mapping.output.figures import write_figures

    truth = read_truth(options.truth)
    believed = read_trajectory(options.trajectory) if options.trajectory else None
    scores = evaluate_truth(map_, truth, believed=believed)
    if options.figures:
        with console.progress(f"drawing into {options.figures}"):
            write_figures(map_, options.figures, truth.truth_at(map_).height_m, scores)
    return scores
