"""Products of the rigs replace earlier ones of their kind, and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

import cli
from calibration_rigs.errors import RigError
from calibration_rigs.plate_rig.products import COLUMNS as CELL_COLUMNS
from calibration_rigs.plate_rig.report import check_products
from calibration_rigs.replaced import check_replaced, of_schema, of_table
from calibration_rigs.static_rig.deviations import COLUMNS
from mapping.calibration_file import noise_to_json
from mapping.inertial_calibration import InertialFile
from mapping.noise import NGUYEN_2012

NOISE = noise_to_json(NGUYEN_2012)
INERTIAL = InertialFile(schema="terravibe/inertial", version=1).to_json()


@pytest.mark.parametrize("before", [NOISE, "[recording]\nname = 'moon'\n", "[1]", "\xff"])
def test_a_static_calibration_replaces_no_other_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], before: str
) -> None:
    output = tmp_path / "depth.json"
    output.write_bytes(before.encode("latin-1"))
    assert cli.main(["calibrate", "static", "--rest", "no.mcap", "-o", str(output)]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert f"{output} is there and is no inertial calibration, which alone is replaced" in line
    assert output.read_bytes() == before.encode("latin-1")


@pytest.mark.parametrize("before", [INERTIAL, ""])
def test_an_earlier_product_and_an_empty_file_are_replaced(tmp_path: Path, before: str) -> None:
    path = tmp_path / "static.json"
    check_replaced(path, "inertial calibration", of_schema("terravibe/inertial"))
    path.write_text(before)
    check_replaced(path, "inertial calibration", of_schema("terravibe/inertial"))


@pytest.mark.parametrize("end", ["", "\n", "\r\nyaw,adev,1,2\r\n"])
def test_a_table_is_told_by_its_first_line(end: str) -> None:
    assert of_table(COLUMNS)(f"{COLUMNS}{end}".encode())
    assert not of_table(COLUMNS)(f"{COLUMNS},more{end}".encode())


def test_a_plate_calibration_replaces_neither_its_list_nor_other_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The list of the recordings may have the name that the table of the results has."""
    cells = tmp_path / "cells.csv"
    cells.write_text("recording,distance_m,angle_deg\nc0,1.0,0\n")
    assert cli.main(["calibrate", "plate", str(cells)]) == 2
    assert f"{cells} is there and is no table of calibrated cells" in capsys.readouterr().err
    cells.write_text(f"{CELL_COLUMNS}\n")
    (tmp_path / "calibration.json").write_text(NOISE)
    check_products(tmp_path)
    for name, content in (("calibration.json", INERTIAL), ("elevation_mapping.yaml", "a: 1\n")):
        (tmp_path / name).write_text(content)
        with pytest.raises(RigError, match=f"{name} is there and is no"):
            check_products(tmp_path)
        (tmp_path / name).unlink()
