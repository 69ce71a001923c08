"""terravibe's command line: parse, call one function, print, exit code.

Exit codes: 0 ok, 1 a check failed or the input was damaged, 2 wrong usage or unusable input.
Nothing heavy is imported before a command is known, so that `--help` answers at once.
"""

from __future__ import annotations

import argparse
import importlib
import json
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from acquisition.byte_source import ByteSource
    from acquisition.stream_reader import StreamMessage
    from mapping.elevation_map import ElevationMap
    from mapping.session import MapOptions, MapResult

_ROOMS = ("drivers", "acquisition", "mapping", "simulation")
_OK, _CHECK_FAILED, _UNUSABLE, _INTERRUPTED = 0, 1, 2, 130


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        """Exit with 2; see `argparse.ArgumentParser.error`."""
        self.exit(_UNUSABLE, f"{self.prog}: error: {message}; see {self.prog} --help\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    wrong_room = _shadowed_room()
    if wrong_room:
        return _fail(wrong_room)
    options = _parser().parse_args(arguments)
    return _run(options.run, options)


def _run(command: Callable[[argparse.Namespace], int], options: argparse.Namespace) -> int:
    """Call the command; a known failure becomes one line and an exit code."""
    from drivers.errors import TerravibeError

    try:
        return command(options)
    except TerravibeError as error:
        return _fail(str(error))
    except KeyboardInterrupt:
        print("terravibe: interrupted; no output was written", file=sys.stderr)
        return _INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output has gone; keep the interpreter from complaining at exit.
        sys.stdout = None  # type: ignore[assignment]
        return _OK
    except OSError as error:
        where = f" {error.filename}" if error.filename else ""
        return _fail(f"the system refused{where}: {error.strerror or error}")


def _fail(message: str) -> int:
    print(f"terravibe: error: {' '.join(message.split())}", file=sys.stderr)
    return _UNUSABLE


def _shadowed_room() -> str:
    """Return what is wrong when another distribution took one of the top-level names."""
    here = Path(__file__).resolve().parent
    for room in _ROOMS:
        module = importlib.import_module(room)
        origin = Path(module.__file__ or "?").resolve().parent
        if getattr(module, "DISTRIBUTION", None) != "terravibe" or origin.parent != here:
            return (
                f"the package {room!r} comes from {origin}, not from terravibe; another "
                "distribution uses that name: install terravibe into an environment of its own"
            )
    return ""


# ---------------------------------------------------------------- arguments


def _numbers(count: int, form: str) -> Callable[[str], tuple[float, ...]]:
    """Return a parser of `count` comma-separated numbers."""

    def parse(text: str) -> tuple[float, ...]:
        try:
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        if len(values) != count:
            raise argparse.ArgumentTypeError(f"found {text!r}, expected {form}")
        return values

    return parse


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="terravibe",
        description="Records a rover's sensors as one MCAP stream and turns it into an elevation "
        "map with an honest uncertainty.",
    )
    commands = parser.add_subparsers(metavar="COMMAND", required=True, parser_class=_Parser)
    _add_demo(commands)
    _add_import(commands)
    _add_info_and_check(commands)
    _add_map(commands)
    _add_export(commands)
    _add_evaluate(commands)
    _add(commands, "warmup", "compile the mapping kernels now, not at the first frame", _warmup)
    return parser


def _add(
    commands: Any, name: str, text: str, run: Callable[[argparse.Namespace], int]
) -> argparse.ArgumentParser:
    """Add a command with its help and the function that runs it."""
    parser: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text)
    parser.set_defaults(run=run)
    return parser


def _add_demo(commands: Any) -> None:
    text = "simulate a drive, record it, map it while it is recorded, compare with the truth"
    parser = _add(commands, "demo", text, _demo)
    parser.add_argument("--out", type=Path, default=Path("terravibe-demo"), metavar="DIR")
    parser.add_argument("--seed", type=int, default=3, metavar="N", help="terrain and noise")
    parser.add_argument("--seconds", type=float, default=12.0, metavar="S", help="of driving")
    parser.add_argument("--json", action="store_true", help="print the scores as JSON")


def _add_import(commands: Any) -> None:
    parser = commands.add_parser("import", help="turn a folder of depth images into a recording")
    kinds = parser.add_subparsers(metavar="KIND", required=True, parser_class=_Parser)
    tum = _add(kinds, "tum", "a folder in the TUM RGB-D layout", _import_tum)
    tum.add_argument("--depth-scale", type=float, default=5000.0, metavar="COUNTS_PER_M")
    tum.add_argument("--no-poses", action="store_true", help="do not read groundtruth.txt")
    png = _add(kinds, "png", "a folder of 16-bit PNG images in millimetres", _import_png)
    png.add_argument("--poses", type=Path, metavar="FILE", help="trajectory in TUM format")
    png.add_argument("--rate-hz", type=float, metavar="HZ", help="when the names are numbers")
    for kind in (tum, png):
        _add_import_options(kind)


def _add_import_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.mcap")
    parser.add_argument(
        "--intrinsics",
        type=_numbers(4, "fx,fy,cx,cy in pixels"),
        required=True,
        metavar="FX,FY,CX,CY",
        help="pinhole intrinsics of the depth camera in pixels",
    )
    parser.add_argument("--pose-sigma-m", type=float, metavar="M", help="1 sigma of each position")
    parser.add_argument("--pose-sigma-deg", type=float, metavar="DEG", help="1 sigma of rotation")
    parser.add_argument("--max-pose-gap-s", type=float, metavar="S", help="longest interpolation")
    parser.add_argument(
        "--mount-sigma-m",
        type=float,
        default=0.005,
        metavar="M",
        help="1 sigma of the camera's place on the tracked body (default 0.005)",
    )
    parser.add_argument(
        "--mount-sigma-deg",
        type=float,
        default=0.5,
        metavar="DEG",
        help="1 sigma of the camera's rotation on the tracked body (default 0.5)",
    )


def _add_info_and_check(commands: Any) -> None:
    for name, text, run in (
        ("info", "say what a recording or a map holds", _info),
        ("check", "look for damage, gaps and missing parts; exit 1 when there are any", _check),
    ):
        parser = _add(commands, name, text, run)
        parser.add_argument("file", type=Path)
        parser.add_argument("--json", action="store_true")


def _add_map(commands: Any) -> None:
    parser = _add(commands, "map", "turn a recording into an elevation map", _map)
    add = parser.add_argument
    add("recording", help="MCAP file, or - for standard input")
    add("-o", "--output", type=Path, required=True, metavar="FILE.nc")
    add("--follow", action="store_true", help="map a file that is still being written")
    add("--idle-timeout-s", type=float, metavar="S", help="with --follow: end after S s of silence")
    add("--reorder-window-s", type=float, default=0.5, metavar="S", help="how late a message may be")
    add("--resolution", dest="resolution_m", type=float, metavar="M", help="cell size (0.04)")
    add("--grid", choices=("growing", "scrolling"), help="keep everything, or a window")
    add("--window-m", type=float, metavar="M", help="edge of the scrolling window (6)")
    add("--noise", metavar="MODEL", help="preset, constant:SIGMA_M, or a calibration file")
    add("--range-min-m", type=float, metavar="M", help="nearest depth that is mapped (0.4)")
    add("--range-max-m", type=float, metavar="M", help="farthest depth that is mapped (4)")
    add("--mount-sigma-m", type=float, metavar="M", help="overrides the recording's value")
    add("--mount-sigma-deg", type=float, metavar="DEG", help="overrides the recording's value")
    add("--gate-sigma", type=float, metavar="N", help="reject beyond N sigma (3.5)")
    add("--common-correlation-time-s", type=float, metavar="S", help="of pose errors (0.3)")
    add("--pose-gap-max-s", type=float, metavar="S", help="longest pose interpolation (0.2)")
    add("--figures", type=Path, metavar="DIR", help="also draw the figures")
    add("--json", action="store_true", help="print the result as JSON")


def _add_export(commands: Any) -> None:
    text = "convert a map; the ending of the output chooses the format: .tif, .ply, .png"
    parser = _add(commands, "export", text, _export)
    parser.add_argument("map", type=Path)
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help=".tif, .ply or .png")
    parser.add_argument("--figures", type=Path, metavar="DIR", help="draw all figures into DIR")


def _add_evaluate(commands: Any) -> None:
    parser = _add(commands, "evaluate", "compare a map with the truth or with a flat floor", _evaluate)
    parser.add_argument("map", type=Path)
    judge = parser.add_mutually_exclusive_group(required=True)
    judge.add_argument("--truth", type=Path, metavar="FILE.nc")
    judge.add_argument("--floor-height-m", type=float, metavar="M", help="height of a flat floor")
    parser.add_argument("--box", type=Path, metavar="FILE", help="a box that stands on the floor")
    parser.add_argument("--json", action="store_true")


# ---------------------------------------------------------------- output


def _print_lines(lines: Sequence[str]) -> None:
    for line in lines:
        print(line)


def _print_json(value: object) -> None:
    print(json.dumps(value, indent=2, allow_nan=False))


def _note(text: str) -> None:
    """Tell the user something beside the result."""
    print(f"terravibe: {text}", file=sys.stderr)


@contextmanager
def _progress(text: str) -> Iterator[Callable[[str], None]]:
    """Show progress on a terminal; the function given takes what has been reached."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console

    console = Console(stderr=True)
    with console.status(text) as status:
        yield lambda reached: status.update(f"{text}: {reached}")


def _frame_counter(show: Callable[[str], None]) -> Callable[[StreamMessage], None]:
    """Return a function that counts the depth frames among the messages."""
    frames = 0

    def count(message: StreamMessage) -> None:
        nonlocal frames
        if message.topic == "/depth/image":
            frames += 1
            show(f"{frames} depth frames")

    return count


# ---------------------------------------------------------------- commands


def _prepare_kernels() -> None:
    """Compile the kernels if this installation never did, and say so."""
    from mapping.kernel_cache import compile_kernels, kernels_are_cached

    if not kernels_are_cached():
        _note("compiling the mapping kernels; once per installation, takes about 20 s")
    compile_kernels()


def _warmup(_: argparse.Namespace) -> int:
    _prepare_kernels()
    print("the mapping kernels are compiled and cached")
    return _OK


def _import_tum(options: argparse.Namespace) -> int:
    extra = {"depth_scale": options.depth_scale, "with_poses": not options.no_poses}
    return _import("tum", options, extra)


def _import_png(options: argparse.Namespace) -> int:
    return _import("png", options, {"poses": options.poses, "rate_hz": options.rate_hz})


def _import(kind: str, options: argparse.Namespace, extra: dict[str, object]) -> int:
    from math import radians

    from acquisition.frames import camera_is_tracked_body
    from acquisition.importing import record_all
    from drivers.source import make_source

    if options.pose_sigma_m is not None:
        extra["pose_sigma_m"] = options.pose_sigma_m
    if options.pose_sigma_deg is not None:
        extra["pose_sigma_rad"] = radians(options.pose_sigma_deg)
    if options.max_pose_gap_s is not None:
        extra["max_pose_gap_s"] = options.max_pose_gap_s
    source = make_source(kind, folder=options.folder, intrinsics_px=options.intrinsics, **extra)
    settings = {
        "mount_sigma_m": options.mount_sigma_m,
        "mount_sigma_rad": radians(options.mount_sigma_deg),
    }
    with _progress(f"importing {options.folder}") as show:
        summary = record_all(
            source,
            options.output,
            static_transforms=[camera_is_tracked_body()],
            settings=settings,
            progress=lambda samples: show(f"{samples} samples"),
        )
    print(f"{options.output}: {summary.samples} samples from {options.folder}")
    return _OK


def _info(options: argparse.Namespace) -> int:
    if options.file.suffix == ".nc":
        from mapping.map_file import read_map
        from mapping.map_summary import summarise

        summary = summarise(read_map(options.file))
    else:
        from acquisition.inspection import inspect

        summary = inspect(options.file)
    if options.json:
        _print_json(summary.as_json())
    else:
        _print_lines(summary.describe())
    return _OK


def _check(options: argparse.Namespace) -> int:
    from dataclasses import asdict

    from acquisition.inspection import check

    findings = check(options.file)
    if options.json:
        _print_json({"findings": [asdict(finding) for finding in findings]})
    elif findings:
        _print_lines([f"{f.kind}: {f.topic + ': ' if f.topic else ''}{f.text}" for f in findings])
    else:
        print(f"{options.file}: nothing wrong found")
    return _CHECK_FAILED if findings else _OK


def _map(options: argparse.Namespace) -> int:
    from acquisition.stream_reader import StreamReader
    from mapping.map_file import check_writable, write_map
    from mapping.session import map_stream

    map_options = _map_options(options)
    check_writable(options.output)
    with _byte_source(options) as source:
        _prepare_kernels()
        reader = StreamReader(source, reorder_window_ns=round(options.reorder_window_s * 1e9))
        with _progress(f"mapping {options.recording}") as show:
            result = map_stream(reader, map_options, _frame_counter(show))
    write_map(result.map, options.output)
    if options.figures:
        _draw(result.map, options.figures)
    return _report(result, options)


def _map_options(options: argparse.Namespace) -> MapOptions:
    from math import radians

    from mapping.calibration_file import noise_from_name
    from mapping.session import MapOptions
    from mapping.settings import MapSettings

    names = (
        "resolution_m",
        "grid",
        "window_m",
        "range_min_m",
        "range_max_m",
        "gate_sigma",
        "common_correlation_time_s",
        "pose_gap_max_s",
    )
    given = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    degrees = options.mount_sigma_deg
    return MapOptions(
        settings=MapSettings(**given),
        noise=noise_from_name(options.noise) if options.noise else None,
        mount_sigma_m=options.mount_sigma_m,
        mount_sigma_rad=None if degrees is None else radians(degrees),
    )


@contextmanager
def _byte_source(options: argparse.Namespace) -> Iterator[ByteSource]:
    """Open the recording; with --follow, Ctrl-C ends the stream and the map is written."""
    from acquisition.byte_source import FinishedFile, GrowingFile, standard_input

    if options.recording == "-":
        yield standard_input()
    elif not options.follow:
        with FinishedFile(Path(options.recording)) as finished:
            yield finished
    else:
        stopped = False

        def stop(*_: object) -> None:
            nonlocal stopped
            stopped = True

        timeout = float("inf") if options.idle_timeout_s is None else options.idle_timeout_s
        before = signal.signal(signal.SIGINT, stop)
        try:
            path = Path(options.recording)
            with GrowingFile(path, idle_timeout_s=timeout, stop=lambda: stopped) as growing:
                yield growing
        finally:
            signal.signal(signal.SIGINT, before)


def _report(result: MapResult, options: argparse.Namespace) -> int:
    """Print what was mapped; warn of everything that was not."""
    from mapping.map_summary import summarise_result

    summary = summarise_result(result)
    if options.json:
        _print_json(summary.as_json())
    else:
        print(f"{options.output}:")
        _print_lines(summary.describe())
    for warning in summary.warnings:
        _note(f"warning: {warning}")
    return _CHECK_FAILED if result.report.damaged else _OK


def _draw(map_: ElevationMap, folder: Path) -> None:
    from mapping.figures import write_figures

    with _progress(f"drawing into {folder}"):
        write_figures(map_, folder)


def _export(options: argparse.Namespace) -> int:
    from mapping.errors import MappingError
    from mapping.export import export
    from mapping.map_file import read_map

    if options.output is None and options.figures is None:
        raise MappingError("nothing to do; give -o FILE (.tif, .ply, .png), --figures DIR, or both")
    map_ = read_map(options.map)
    if options.output:
        export(map_, options.output)
        print(options.output)
    if options.figures:
        _draw(map_, options.figures)
        print(options.figures)
    return _OK


def _evaluate(options: argparse.Namespace) -> int:
    from mapping.floor_evaluation import evaluate_floor, read_box
    from mapping.map_file import read_map
    from mapping.truth import evaluate_truth, read_truth

    map_ = read_map(options.map)
    if options.truth:
        scores = evaluate_truth(map_, read_truth(options.truth))
    else:
        box = read_box(options.box) if options.box else None
        scores = evaluate_floor(map_, options.floor_height_m, box)
    if options.json:
        _print_json(scores.as_json())
    else:
        _print_lines(scores.lines())
    return _OK


def _demo(options: argparse.Namespace) -> int:
    _prepare_kernels()
    from mapping.demo import run_demo
    from mapping.settings import MapSettings
    from simulation.ideal_camera import IDEAL_CAMERA_NOISE
    from simulation.ideal_drive import IdealDrive

    drive = IdealDrive(options.seed, options.seconds)
    with _progress(f"driving {options.seconds:g} s") as show:
        demo = run_demo(
            drive,
            drive.truth,
            IDEAL_CAMERA_NOISE,
            MapSettings(),
            options.out,
            _frame_counter(show),
        )
    if options.json:
        _print_json(demo.as_json())
    else:
        _print_lines(demo.describe())
    return _OK


if __name__ == "__main__":
    sys.exit(main())
