"""`terravibe evaluate odometry`: arguments in, one function called, words out.

Nothing heavy is imported before the command runs.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from acquisition.commands.console import OK, Console, prepare_depth_code, show


def add_comparison_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what `terravibe evaluate odometry` has beyond the evaluation of maps."""
    parser.add_argument(
        "--align",
        choices=("none", "start", "yaw", "se3"),
        help="odometry: how the trajectories are put together (start)",
    )


def compare_trajectories(options: argparse.Namespace, console: Console) -> int:
    """Compare two trajectories, the second being the true one.

    Raises:
        MappingError: not two of them, or they cannot be compared.
    """
    from mapping.errors import MappingError
    from mapping.judging.odometry import evaluate_odometry
    from mapping.judging.trajectory import read_path
    from mapping.output.figure_odometry import write_odometry_figures

    if len(options.subject) != 3:
        raise MappingError(
            f"odometry with {len(options.subject) - 1} files; expected EST and TRUTH: TUM files, "
            ".nc files, or a recording with motion capture as TRUTH"
        )
    of_maps = (options.truth, options.box, options.trajectory, options.origin)
    if any(of_maps) or options.floor_height_m is not None:
        raise MappingError(
            "--truth, --floor-height-m, --box, --trajectory and --origin are for maps; leave them "
            "out"
        )
    prepare_depth_code(console)
    estimate, truth = (read_path(Path(name)) for name in options.subject[1:])
    scores = evaluate_odometry(estimate, truth, options.align or "start")
    if options.figures:
        write_odometry_figures(scores, options.figures)
    show(console, scores, as_json=options.json)
    return OK
