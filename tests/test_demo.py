"""The demo: what a newcomer sees first."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import cli
from acquisition.commands.console import OK
from acquisition.inspection import inspect


def test_the_demo_leaves_a_recording_a_judged_map_and_a_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "demo"
    folder.mkdir()
    (folder / "run.mcap").write_text("of an earlier demo")
    assert cli.main(["demo", "--seconds", "4", "--out", str(folder)]) == OK
    told = capsys.readouterr()
    for step in ("a simulated rover, 4 s", "mapped while it grows", "true terrain", "drawing"):
        assert step in told.err
    assert "RMSE" in told.out
    assert "P99" in told.out
    assert {path.name for path in folder.iterdir()} == {
        *("run.mcap", "map.nc", "truth.nc", "metrics.json", "report.html", "figures"),
    }
    page = (folder / "report.html").read_text()
    assert "99 % of them are within" in page
    assert "Relative to the rover" in page
    assert {path.stem for path in (folder / "figures").iterdir()} >= {"error", "scores"}
    topics = inspect(folder / "run.mcap").as_json()["topics"]
    for topic in ("/vibration", "/acceleration", "/gyro", "/can", "/wheels", "/mocap/pose"):
        assert topic in json.dumps(topics)
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["rmse_m"] < 0.0025
    assert metrics["run"]["counts"]["frames"] == 40
    truth = ["--truth", str(folder / "truth.nc"), "--json"]
    assert cli.main(["evaluate", str(folder / "map.nc"), *truth]) == OK
    judged = json.loads(capsys.readouterr().out)
    assert {name: metrics[name] for name in judged} == judged
