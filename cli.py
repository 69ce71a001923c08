"""terravibe's command line: parse, call one function, print, exit code.

Exit codes: 0 ok, 1 a check failed or the input was damaged, 2 wrong usage or unusable input.
Nothing heavy is imported before a command runs, so that `--help` answers at once.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

if TYPE_CHECKING:
    from acquisition.commands.console import Board
    from acquisition.messages.frames import StaticTransform
    from simulation.scenarios import Scenario

_UNUSABLE = 2
_INTERRUPTED = 130
_ROOMS = ("drivers", "acquisition", "mapping", "calibration_rigs", "simulation")


class _Command(NamedTuple):
    """A command: what it does, and the module with its `add_NAME_arguments` and `run_NAME`."""

    text: str
    module: str


_COMMANDS = {
    "demo": _Command("simulate a drive, record it, map it live, compare with the truth", "cli"),
    "simulate": _Command("record a simulated drive, and write its truth beside it", "cli"),
    "devices": _Command("say what is plugged in and usable", "acquisition.commands.devices"),
    "config": _Command("make, check or show a rover.toml", "acquisition.commands.record"),
    "record": _Command("record all devices of a rover.toml", "acquisition.commands.record"),
    "import": _Command("turn depth images into a recording", "acquisition.commands.recordings"),
    "info": _Command("say what a recording or a map holds", "mapping.commands"),
    "check": _Command("look for damage and gaps in a recording", "acquisition.commands.recordings"),
    "recover": _Command("save what is intact of a recording", "acquisition.commands.record"),
    "cut": _Command("copy a part of a recording", "acquisition.commands.record"),
    "merge": _Command("copy several recordings into one", "acquisition.commands.record"),
    "map": _Command("turn a recording into an elevation map", "mapping.commands"),
    "odometry": _Command("find the rover's way from its own sensors", "mapping.odometry_command"),
    "export": _Command("convert a map to GeoTIFF, PLY, PNG; draw it", "mapping.output.commands"),
    "evaluate": _Command("compare a map or a way with the truth", "mapping.judging.commands"),
    "calibrate": _Command("make calibration files on a rig", "calibration_rigs.commands"),
    "warmup": _Command("compile what is compiled once, now", "mapping.commands"),
}


class Terminal:
    """Standard output for results, standard error for everything else."""

    def lines(self, lines: Iterable[str]) -> None:
        """Print the result, for people."""
        for line in lines:
            print(line.encode(errors="backslashreplace").decode())  # names may be no text

    def json(self, value: object) -> None:
        """Print the result, for programs."""
        print(json.dumps(value, indent=2, allow_nan=False))

    def note(self, text: str) -> None:
        """Tell the user something beside the result."""
        print(f"terravibe: {text}", file=sys.stderr)

    @contextmanager
    def progress(self, text: str) -> Iterator[Callable[[str], None]]:
        """Show on a terminal what has been reached; say nothing elsewhere."""
        if not sys.stderr.isatty():
            yield lambda _: None
            return
        from rich.console import Console

        with Console(stderr=True).status(text) as status:
            yield lambda reached: status.update(f"{text}: {reached}")

    @contextmanager
    def board(self) -> Iterator[Board]:
        """Show a picture where a terminal can redraw it, and lines elsewhere."""
        from rich.console import Console
        from rich.live import Live

        console = Console(stderr=True)
        if not sys.stderr.isatty() or console.is_dumb_terminal:
            yield self._log
            return
        with Live(console=console, auto_refresh=False) as live:

            def draw(picture: Callable[[], Any], lines: Callable[[], list[str]]) -> None:
                """Redraw the picture in its place."""
                del lines  # those are for a log
                live.update(picture(), refresh=True)

            yield draw

    def _log(self, picture: Callable[[], object], lines: Callable[[], list[str]]) -> None:
        del picture  # that is for a terminal
        for line in lines():
            self.note(line)


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        """Exit with 2; see `argparse.ArgumentParser.error`."""
        self.exit(_UNUSABLE, f"{self.prog}: error: {message}; see {self.prog} --help\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    try:
        if shadowed := _shadowed_room():
            return _fail(shadowed)
        return _run(*_parse(list(sys.argv[1:] if arguments is None else arguments)))
    except KeyboardInterrupt:
        print("terravibe: interrupted; no file is left half-written", file=sys.stderr)
        return _INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output has gone; keep the interpreter from complaining at exit.
        sys.stdout = None
        return 0


def _parse(words: list[str]) -> tuple[str, argparse.Namespace]:
    """Parse in two steps, so that only the chosen command's module is imported."""
    parser = _Parser(
        prog="terravibe",
        description="Records a rover's sensors as one MCAP stream and turns it into an elevation "
        "map with an honest uncertainty.",
    )
    parser.add_argument("--version", action="store_true", help="print the version and stop")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=_Parser)
    chosen = next((word for word in words if not word.startswith("-")), None)
    for name, command in _COMMANDS.items():
        child = commands.add_parser(name, help=command.text, description=command.text)
        if name == chosen:
            _member(name, "add_{}_arguments")(child)
    options = parser.parse_args(words)
    if options.version:
        from importlib.metadata import version

        parser.exit(0, f"terravibe {version('terravibe')}\n")
    if options.command is None:
        parser.error(f"no command; expected one of {', '.join(_COMMANDS)}")
    return str(options.command), options


def _member(command: str, pattern: str) -> Callable[..., int]:
    """Return the command's function of that name."""
    module = _COMMANDS[command].module
    owner = sys.modules[__name__] if module == "cli" else importlib.import_module(module)
    function: Callable[..., int] = getattr(owner, pattern.format(command))
    return function


def _run(name: str, options: argparse.Namespace) -> int:
    """Run a command; a known failure becomes one line and an exit code."""
    from acquisition.commands.signals import ended_like_interrupted
    from drivers.errors import TerravibeError

    try:
        with ended_like_interrupted():
            return _member(name, "run_{}")(options, Terminal())
    except TerravibeError as error:
        return _fail(str(error))
    except BrokenPipeError:
        raise
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
        try:
            module = importlib.import_module(room)
        except ModuleNotFoundError as error:
            return f"{error}; this installation is older than its source: install terravibe again"
        origin = Path(module.__file__ or "?").resolve().parent
        if getattr(module, "DISTRIBUTION", None) != "terravibe" or origin.parent != here:
            return (
                f"the package {room!r} comes from {origin}, not from terravibe; another "
                "distribution uses that name: install terravibe into an environment of its own"
            )
    return ""


def add_demo_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe demo`."""
    out = Path("terravibe-demo")
    parser.add_argument(
        "--out", type=Path, default=out, metavar="DIR", help=f"all goes there ({out})"
    )
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="of all that is random (1)"
    )
    parser.add_argument(
        "--seconds", type=float, default=15.0, metavar="S", help="length of the run (15)"
    )
    parser.add_argument("--json", action="store_true", help="print the scores as JSON")


def run_demo(options: argparse.Namespace, console: Terminal) -> int:
    """Simulate, record, map live, judge and report."""
    from acquisition.commands.console import show
    from mapping.commands import frame_counter, prepare_kernels
    from mapping.demo import Demo, run
    from simulation.scenario_source import ScenarioSource
    from simulation.scenarios import make_scenario

    scenario = make_scenario("simulation", options.seed, options.seconds)
    prepare_kernels(console)
    console.note(
        f"a simulated rover, {options.seconds:g} s over lunar ground, seed {options.seed}: Kinect, "
        "vibration sensor, yaw gyro, wheels on CAN; the map is made with its true poses"
    )
    with console.progress("simulating") as reached:
        source = ScenarioSource(scenario, on_progress=lambda s: reached(f"driven {s:.0f} s"))
        demo = Demo(source, source.write_truth, *_recorded_with(scenario))
        result = run(demo, options.out, console.note, frame_counter(reached))
    show(console, result, as_json=options.json)
    return 0


def _recorded_with(scenario: Scenario) -> tuple[list[StaticTransform], dict[str, object]]:
    """Return the mounts and the settings that belong into a scenario's recording."""
    from acquisition.messages.frames import StaticTransform
    from simulation.devices.kinect_noise import recording_settings
    from simulation.devices.sensor_mounts import sensor_mounts

    mounts = sensor_mounts(scenario.options, scenario.mount)
    return [StaticTransform(*mount) for mount in mounts], recording_settings(scenario.camera.model)


def add_simulate_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe simulate`."""
    from acquisition.commands.arguments import product

    names = "simulation, smooth, rough, indoor or outdoor"
    parser.add_argument("scenario", metavar="SCENARIO", help=names)
    parser.add_argument("-o", "--output", type=product(".mcap"), required=True, metavar="RUN.mcap")
    parser.add_argument("--truth", type=product(".nc"), required=True, metavar="TRUTH.nc")
    seed = "of all that is random (1)"
    parser.add_argument("--seed", type=int, default=1, metavar="N", help=seed)
    parser.add_argument("--seconds", type=float, default=20.0, metavar="S", help="length (20)")
    parser.add_argument("--poses", choices=("true", "mocap"), help="instead of the scenario's own")
    parser.add_argument("--json", action="store_true", help="print what was written as JSON")


def run_simulate(options: argparse.Namespace, console: Terminal) -> int:
    """Drive, record and tell the truth; both files appear, or none."""
    from acquisition.commands.console import show
    from acquisition.files import replacing
    from acquisition.importing import record_all
    from simulation.run_summary import SimulatedRun
    from simulation.scenario_source import ScenarioSource
    from simulation.scenarios import make_scenario

    output, truth, seconds = options.output, options.truth, options.seconds
    begin = time.monotonic()
    scenario = make_scenario(options.scenario, options.seed, seconds, options.poses)
    mounts, settings = _recorded_with(scenario)
    with console.progress(f"simulating {seconds:g} s") as reached, replacing(truth) as new_truth:
        source = ScenarioSource(scenario, on_progress=lambda s: reached(f"driven {s:.0f} s"))
        summary = record_all(
            source,
            output,
            static_transforms=mounts,
            settings=settings,
            progress=lambda samples: reached(f"recorded {samples} samples"),
            when_complete=lambda: source.write_truth(new_truth),
        )
    took_s, stuck_s = time.monotonic() - begin, source.motion.stuck_s
    done, size = dict(summary.samples), summary.size_bytes
    run = SimulatedRun(str(output), str(truth), done, size, seconds, took_s, stuck_s)
    show(console, run, as_json=options.json)
    if stuck_s:
        console.note(f"warning: the rover was stuck for {stuck_s:.1f} s of the run")
    return 0


if __name__ == "__main__":
    sys.exit(main())
