"""The commands that record, and that make new recordings of old ones.

Nothing heavy is imported before a command runs.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.commands.arguments import names, product, seconds
from acquisition.commands.console import (
    CHECK_FAILED,
    OK,
    Console,
    prepare_depth_code,
    show,
)
from acquisition.commands.signals import stopped_by_signals

if TYPE_CHECKING:
    from acquisition.config.rover_file import LoadedConfig
    from acquisition.health.snapshot import HealthSnapshot


def add_record_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe record`."""
    parser.epilog = (
        "SIGINT (Ctrl-C), SIGTERM and SIGHUP end the recording properly; SIGUSR1 has a ring "
        "(ring_s) written. Exits with 1 when not everything could be written, a device hangs, or "
        "--preflight misses one; with 2 when recording cannot start."
    )
    add = parser.add_argument
    add(
        "--config",
        type=Path,
        default=Path("rover.toml"),
        metavar="FILE",
        help="what to record (rover.toml)",
    )
    add(
        "-o",
        "--output",
        type=product(".mcap"),
        metavar="FILE.mcap",
        help="instead of a name with the time",
    )
    add("--require", action="store_true", help="refuse to start unless every device answers")
    add("--seconds", type=seconds, metavar="S", help="stop by itself after so long")
    add("--preflight", action="store_true", help="open every device, report, and stop")
    add("--json", action="store_true", help="print the result as JSON")


def run_record(options: argparse.Namespace, console: Console) -> int:
    """Record until SIGINT, SIGTERM or SIGHUP; 1 when the output failed or a device hangs."""
    from acquisition.config.rover_file import load

    loaded = load(options.config)
    if options.preflight:
        return _preflight(loaded, console, as_json=options.json)
    return _record(options, loaded, console)


def _preflight(loaded: LoadedConfig, console: Console, *, as_json: bool) -> int:
    from acquisition.config.use import sources_of
    from acquisition.recording.preflight import preflight

    report = preflight(sources_of(loaded))
    show(console, report, as_json=as_json)
    return CHECK_FAILED if report.missing else OK


def _record(options: argparse.Namespace, loaded: LoadedConfig, console: Console) -> int:
    from dataclasses import replace

    from acquisition.clocks.host_clock import HostClock
    from acquisition.config.use import output_of, plan_of, recording_path, sources_of
    from acquisition.files import check_target
    from acquisition.health.snapshot import as_json
    from acquisition.health.views import HealthLog, totals_of
    from acquisition.recording.recorder import Recorder
    from acquisition.recording.service import ServiceNotifier

    clock = HostClock()
    if options.output and not loaded.config.recording.fallback_folders:
        check_target(options.output)
    path = options.output or recording_path(loaded, clock.log_time_ns(clock.now_ns()))
    output = output_of(loaded, path)
    sources = sources_of(loaded)
    plan = plan_of(loaded, sources)
    plan = replace(plan, require_all=plan.require_all or options.require)
    if plan.depth_format == "rvl":
        prepare_depth_code(console)
    recorder = Recorder(sources, output, plan, clock)
    notifier = ServiceNotifier.from_environment()
    log = HealthLog()
    trigger = getattr(output, "trigger", lambda: None)  # a ring has one
    with stopped_by_signals(trigger) as stop, console.board() as board:

        def beat(snapshot: HealthSnapshot) -> None:
            """Tell the service manager and who watches, once a second."""
            notifier.heartbeat(snapshot)
            board(lambda: _dashboard(snapshot), lambda: log.lines(snapshot))

        recorder.preflight(stop)  # which may be long; --seconds are of the recording
        if options.seconds is not None:
            stop.after(options.seconds)
        result = recorder.run(stop, beat)
    notifier.stopping(result.message)
    failed = result.outcome == "output_failed" or bool(result.hanging)
    files = [str(file) for file in result.files]
    if options.json:
        console.json(
            {
                "outcome": result.outcome,
                "message": result.message,
                "files": files,
                "unwritten": result.unwritten,
                "hanging": list(result.hanging),
                "health": as_json(result.health),
            }
        )
    else:
        written = files or ["no file was written; a ring is written at SIGUSR1"]
        console.lines([result.message, *written, *totals_of(result.health)])
    if result.unwritten:
        console.note(f"warning: {result.unwritten} samples were read but could not be written")
    if result.hanging:
        console.note(f"warning: these devices did not stop: {', '.join(result.hanging)}")
    return CHECK_FAILED if failed else OK


def _dashboard(snapshot: HealthSnapshot) -> object:
    from acquisition.health.dashboard import Dashboard  # rich, on a terminal only

    return Dashboard(snapshot)


def add_config_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe config init|check|show|unit`."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    for name, text in (
        ("init", "write a rover.toml with every default, to be edited"),
        ("check", "say everything that is wrong with it, then exit with 1; touches no device"),
        ("show", "print every setting, defaults included, as JSON"),
    ):
        action = actions.add_parser(name, help=text, description=text)
        action.add_argument(
            "file", type=Path, nargs="?", default=Path("rover.toml"), help="its name (rover.toml)"
        )
    text = "print the systemd unit file of the recorder"
    actions.add_parser("unit", help=text, description=text)


def run_config(options: argparse.Namespace, console: Console) -> int:
    """Make, check or show a rover.toml."""
    from acquisition.config.rover_file import default_text, load
    from acquisition.config.use import check, resolved
    from acquisition.errors import ConfigError
    from acquisition.files import replacing
    from acquisition.recording.service import unit_text

    if options.action == "unit":
        console.lines([unit_text().rstrip()])
    elif options.action == "show":
        console.json(resolved(load(options.file)))
    elif options.action == "check":
        problems = check(options.file)
        console.lines(problems or [f"{options.file}: nothing wrong found"])
        return CHECK_FAILED if problems else OK
    elif options.file.exists():
        raise ConfigError(f"{options.file} exists; edit it, or give another name")
    else:
        with replacing(options.file) as temporary:
            temporary.write_text(default_text(), encoding="utf-8")
        console.lines([f"{options.file}: written; add your devices"])
    return OK


def add_recover_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe recover`."""
    parser.epilog = "Exits with 1 when something was wrong with the recording, and says what."
    parser.add_argument("recording", type=Path, help="damaged, or cut short; stays as it is")
    _add_new_recording(parser)
    parser.add_argument("--json", action="store_true", help="print what was lost as JSON")


def _add_new_recording(parser: argparse.ArgumentParser) -> None:
    text = "the new recording; a file that is there is not replaced"
    kind = product(".mcap")
    parser.add_argument("-o", "--output", type=kind, required=True, metavar="FILE.mcap", help=text)


def run_recover(options: argparse.Namespace, console: Console) -> int:
    """Copy what is intact of a damaged recording; 1 when something was lost."""
    from acquisition.files import refuse_existing
    from acquisition.recovery.recover import recover

    refuse_existing(options.output)
    with console.progress(f"recovering {options.recording}") as reached:
        report = recover(
            options.recording,
            options.output,
            progress=lambda done: reached(f"{done:.0%}"),
        )
    show(console, report, as_json=options.json)
    return OK if report.sound else CHECK_FAILED


def add_cut_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe cut`."""
    add = parser.add_argument
    add("recording", type=Path, help="stays as it is")
    _add_new_recording(parser)
    add("--start-s", type=seconds, metavar="S", help="from S seconds after the first message on")
    add("--end-s", type=seconds, metavar="S", help="until then, counted likewise, not included")
    add("--start-ns", type=int, metavar="NS", help="a log time instead")
    add("--end-ns", type=int, metavar="NS", help="a log time instead")
    add("--topics", type=names, metavar="TOPIC,...", help="these, and /tf_static")
    add("--json", action="store_true", help="print what was copied as JSON")


def run_cut(options: argparse.Namespace, console: Console) -> int:
    """Copy what lies between two times, or some of the topics."""
    from acquisition.editing.cut_and_merge import cut
    from acquisition.files import refuse_existing

    refuse_existing(options.output)
    with console.progress(f"cutting {options.recording}") as reached:
        report = cut(
            options.recording,
            options.output,
            start_s=options.start_s,
            end_s=options.end_s,
            start_ns=options.start_ns,
            end_ns=options.end_ns,
            topics=options.topics,
            progress=lambda done: reached(f"{done:.0%}"),
        )
    show(console, report, as_json=options.json)
    return OK


def add_merge_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe merge`."""
    parser.add_argument("recordings", type=Path, nargs="+", help="two or more, in any order")
    _add_new_recording(parser)
    parser.add_argument("--json", action="store_true", help="print what was copied as JSON")


def run_merge(options: argparse.Namespace, console: Console) -> int:
    """Copy several recordings into one, by log time."""
    from acquisition.editing.cut_and_merge import merge
    from acquisition.files import refuse_existing

    refuse_existing(options.output)
    with console.progress(f"merging {len(options.recordings)} recordings") as reached:
        report = merge(
            options.recordings, options.output, progress=lambda done: reached(f"{done:.0%}")
        )
    show(console, report, as_json=options.json)
    return OK
