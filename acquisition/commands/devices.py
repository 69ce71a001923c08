"""`terravibe devices`: what is plugged in, what keeps it from being used, profiles, udev rules.

Nothing heavy is imported before the command runs.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.commands.console import CHECK_FAILED, OK, Console

if TYPE_CHECKING:
    from drivers.discovery import Finding


def add_devices_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe devices [check-profile FILE | probe PORT | udev-rules]`."""
    parser.epilog = "check-profile exits with 1 when it finds problems, probe when nothing answers."
    parser.add_argument(
        "--json", action="store_true", help="print what was found as JSON; before the action"
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION")
    check = actions.add_parser("check-profile", help="check a vibration sensor's profile file")
    check.add_argument("profile", help="a TOML file, or the name of a shipped profile")
    probe = actions.add_parser("probe", help="try all shipped vibration profiles on a serial port")
    probe.add_argument("port", help="such as /dev/ttyUSB0")
    actions.add_parser("udev-rules", help="print the path of the udev rules to install")


def run_devices(options: argparse.Namespace, console: Console) -> int:
    """List devices, or do one of the actions."""
    if options.action == "check-profile":
        return _check_profile(options.profile, console, as_json=options.json)
    if options.action == "probe":
        return _probe(options.port, console, as_json=options.json)
    if options.action == "udev-rules":
        return _udev_rules(console, as_json=options.json)
    return _list(console, as_json=options.json)


def _list(console: Console, *, as_json: bool) -> int:
    from drivers.discovery import find_devices

    findings = find_devices()
    if as_json:
        console.json({"devices": [asdict(finding) for finding in findings]})
    else:
        console.lines([line for finding in findings for line in _describe(finding)])
        if not findings:
            console.lines(["nothing found: no serial port, I2C bus, CAN interface or Kinect"])
    return OK


def _describe(finding: Finding) -> list[str]:
    """Return a finding as one line, or two when something is to be done."""
    mark = "usable" if finding.usable else "NOT usable"
    what = "; ".join(part for part in (finding.what, mark) if part)
    lines = [f"{finding.kind:<7} {finding.where}: {what}"]
    if finding.problem:
        lines.append(f"        {finding.problem}: {finding.advice}")
    return lines


def _udev_rules(console: Console, *, as_json: bool) -> int:
    from drivers.discovery import udev_rules_path

    path = str(udev_rules_path())
    if as_json:
        console.json({"path": path})
    else:
        console.lines([path])
    return OK


def _check_profile(profile: str, console: Console, *, as_json: bool) -> int:
    from drivers.vibration.profile import check_profile, shipped_profiles

    is_shipped = profile in shipped_profiles()
    problems = [str(p) for p in check_profile(profile if is_shipped else Path(profile))]
    if as_json:
        console.json({"profile": profile, "problems": problems})
    else:
        console.lines(problems or [f"{profile}: usable"])
    return CHECK_FAILED if problems else OK


def _probe(port: str, console: Console, *, as_json: bool) -> int:
    from drivers.vibration.profile import shipped_profiles
    from drivers.vibration.sensor import probe_port

    with console.progress(f"listening on {port}"):
        answers = probe_port(port, shipped_profiles())
    words = {True: "answers", False: "nothing"}
    if as_json:
        console.json({"port": port, "answers": dict(answers)})
    else:
        console.lines(f"{name}: {words[heard]}" for name, heard in answers.items())
    return OK if any(answers.values()) else CHECK_FAILED
