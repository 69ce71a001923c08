"""The command that judges maps and trajectories: arguments in, one function called, words out.

Nothing heavy is imported before the command runs.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.commands.console import OK, Console, show
from mapping.judging.trajectory_command import add_comparison_arguments, compare_trajectories

if TYPE_CHECKING:
    from mapping.cells.elevation_map import ElevationMap


def add_evaluate_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe evaluate`."""
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
        metavar="FILE",
        help="with --truth: the poses that the map was made with (.nc or TUM), where they are not "
        "the true ones",
    )
    parser.add_argument(
        "--origin",
        choices=("world", "start"),
        help="with --truth: the map is in the truth's frame, or begins where its rover stood (as "
        "the map says of its poses)",
    )
    parser.add_argument("--figures", type=Path, metavar="DIR", help="draw into DIR")
    parser.add_argument("--json", action="store_true", help="print the scores as JSON")
    add_comparison_arguments(parser)


def run_evaluate(options: argparse.Namespace, console: Console) -> int:
    """Compare a map with the truth or with a flat floor, or two trajectories."""
    from mapping.errors import MappingError
    from mapping.judging.floor_evaluation import evaluate_floor, read_box
    from mapping.output.map_file import read_map

    if options.subject[0] == "odometry":
        return compare_trajectories(options, console)
    if options.align is not None:
        raise MappingError("--align is for evaluate odometry; a map is judged where it lies")
    if len(options.subject) != 1 or (options.truth is None and options.floor_height_m is None):
        raise MappingError(
            "give one map with --truth FILE.nc or --floor-height-m M, or odometry EST TRUTH"
        )
    map_ = read_map(Path(options.subject[0]))
    if options.truth and options.box:
        raise MappingError("--box is for --floor-height-m; a truth knows its boxes")
    if options.truth:
        return _evaluate_truth(map_, options, console)
    if options.trajectory or options.figures or options.origin:
        raise MappingError(
            "--trajectory, --origin and --figures need --truth; a flat floor has none of them"
        )
    box = read_box(options.box) if options.box else None
    scores = evaluate_floor(map_, options.floor_height_m, box)
    show(console, scores, as_json=options.json)
    return OK


def _evaluate_truth(map_: ElevationMap, options: argparse.Namespace, console: Console) -> int:
    """Compare a map with the truth, taken to the map's frame."""
    from mapping.judging.origin import Origin, in_frame_of, origin_name, start_origin
    from mapping.judging.overlap import overlap_warning
    from mapping.judging.trajectory import read_trajectory_of
    from mapping.judging.truth import evaluate_truth, read_truth
    from mapping.output.figures import write_figures

    truth = read_truth(options.truth)
    believed = read_trajectory_of(options.trajectory) if options.trajectory else None
    origin = Origin("world")
    if (options.origin or origin_name(map_)) == "start":
        origin = start_origin(truth, believed)
        truth = in_frame_of(truth, origin)
    if few := overlap_warning(map_, truth):
        console.note(f"warning: {few}")
    pose_source = map_.attributes.get("setting_pose_source", "mocap")
    if believed is None and pose_source != "mocap":
        console.note(
            f"warning: the map's poses are those of {pose_source}, and count as true here: what is "
            "off in the world is so for the rover too; give them with --trajectory"
        )
    scores = evaluate_truth(map_, truth, believed=believed)
    if options.figures:
        with console.progress(f"drawing into {options.figures}"):
            write_figures(map_, options.figures, truth.truth_at(map_).height_m, scores)
    if options.json:
        console.json({**scores.as_json(), "origin": origin.as_json()})
    else:
        console.lines([origin.line(), *scores.describe()])
    return OK
