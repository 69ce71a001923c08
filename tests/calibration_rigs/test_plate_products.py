"""A whole rig: from recordings and images to calibration file, tables, report, and the mapper."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import cli
from acquisition.importing import record_all
from calibration_rigs.errors import RigError
from calibration_rigs.plate_rig.bias import fit_bias
from calibration_rigs.plate_rig.manifest import Manifest, read_manifest
from calibration_rigs.plate_rig.process import CellFailure, PlateResult, process
from calibration_rigs.plate_rig.report import report_html
from calibration_rigs.plate_rig.sigma_models import CellSigmas, Conditions, fit_laws
from calibration_rigs.plate_rig.verdict import cell_warnings, compare_environments, verdict
from drivers.samples import CameraIntrinsics
from mapping.calibration_file import DeviceIdentity, calibration_from_name
from mapping.errors import MappingError
from mapping.noise_choice import calibration_for, calibrations_in
from mapping.undistortion import read_undistortion
from simulation.devices.kinect import KinectModel
from tests.fakes.plate_rig import Plate, PlateCamera, frames_of, true_bias_m, true_sigma_m

CAMERA = CameraIntrinsics(160, 120, 145.0, 145.0, 79.5, 59.5)
MODEL = KinectModel(disparity_bias_px=0.05)
STATIONS_M = (1.2, 1.8, 2.4, 3.0)
ANGLES_DEG = (0.0, 60.0)


def _write_rig(folder: Path, serials: tuple[str, ...] = ("A1",), count: int = 8) -> None:
    """Record the cells and write plate.csv."""
    random = np.random.default_rng(2)
    header = "recording,distance_m,angle_deg,lux,temperature_c,corner_top_left_m,"
    lines = [header + "corner_top_right_m,corner_bottom_left_m"]
    places = [(z, a) for z in STATIONS_M for a in ANGLES_DEG]
    for k, (z_m, angle) in enumerate(places[:count]):
        plate = Plate(z_m, angle)
        name = f"c{k}.mcap"
        source = PlateCamera(
            frames_of(plate, 12, 3, MODEL, CAMERA), CAMERA, serials[k % len(serials)]
        )
        record_all(source, folder / name, static_transforms=[], settings={})
        lines.append(
            ",".join([name, str(z_m), str(angle), "300", "", *map(str, plate.corners_m(random))])
        )
    (folder / "plate.csv").write_text("\n".join(lines) + "\n")


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rig")
    _write_rig(folder)
    return folder


@pytest.fixture(scope="module")
def calibrated(rig: Path) -> PlateResult:
    return process(read_manifest(rig), bootstraps=5)


def test_calibrate_plate(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["calibrate", "plate", str(rig), "--workers", "1", "--undistortion"]) == 0
    out, err = capsys.readouterr()
    assert "8 of 8 cells are used" in out
    assert "8 cells: 12 frames, expected at least 100" in err
    calibration = calibration_from_name(str(rig / "calibration.json"))
    assert calibration.device == DeviceIdentity(model="simulated Kinect V1", serial="A1")
    assert calibration.measured is not None
    assert calibration.measured.cells == 8
    assert calibration.measured.validity.lux_max == 300.0
    assert calibration.measured.validity.temperature_max_c is None
    assert re.fullmatch("[0-9a-f]{64}", calibration.measured.raw_sha256)
    model = calibration.model
    for z_m in (1.5, 2.0, 2.8):
        truth = np.hypot(true_sigma_m(MODEL, z_m, 0.0), z_m**2 / 348.0 / np.sqrt(12.0))
        assert model.axial_sigma_m(np.array(z_m), np.array(0.0)) == pytest.approx(truth, rel=0.05)
        bias = model.bias_m + model.bias_slope * z_m + model.bias_quadratic_per_m * z_m**2
        sigma = float(model.bias_sigma_at_m(np.array(z_m)))
        assert abs(bias - true_bias_m(MODEL, z_m)) < 3.0 * sigma < 0.02
    with (rig / "cells.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 8
    assert all(
        float(r["sigma_low_m"]) < float(r["sigma_m"]) < float(r["sigma_high_m"]) for r in rows
    )
    page = (rig / "report.html").read_text()
    assert page.count("<img src=") == 6
    assert "http" not in page.split("<body>")[1]
    yaml = (rig / "elevation_mapping.yaml").read_text()
    factors = dict(re.findall(r"(normal_factor_\w): (\S+)", yaml))
    a, b, c = (float(factors[f"normal_factor_{name}"]) for name in "abc")
    expected = float(model.axial_sigma_m(np.array(2.0), np.array(0.0)))
    assert a + b * (2.0 - c) ** 2 == pytest.approx(expected, rel=0.02)
    with np.load(rig / "undistortion.npz") as map_:
        assert map_["mean_px"].shape == (120, 160)
        assert map_["cells"].max() == 8
    undistortion = read_undistortion(rig / "undistortion.npz")
    assert undistortion.device.serial == "A1"
    assert undistortion.inverse_m.any()


def test_the_same_from_images(calibrated: PlateResult, tmp_path: Path) -> None:
    """One station as PNG, two as PGM; intrinsics and serial number from plate.toml."""
    text = '[rig]\nintrinsics_px = [145.0, 145.0, 79.5, 59.5]\nserial = "A1"\n'
    for k, z_m in enumerate(STATIONS_M[:3]):
        folder = tmp_path / f"c{k}"
        folder.mkdir()
        for i, depth_mm in enumerate(frames_of(Plate(z_m), 12, 3, MODEL, CAMERA)):
            ending = "png" if k == 0 else "pgm"
            Image.fromarray(depth_mm.astype(np.uint16)).save(folder / f"{i:03d}.{ending}")
        text += f'[[cells]]\nrecording = "c{k}"\ndistance_m = {z_m}\nangle_deg = 0\n'
    (tmp_path / "plate.toml").write_text(text)
    manifest = read_manifest(tmp_path)
    result = process(manifest, bootstraps=5)
    assert result.device.serial == "A1"
    assert [c.sigma_m for c in result.cells] == [c.sigma_m for c in calibrated.cells[0:6:2]]


def test_mixed_devices_are_named(tmp_path: Path) -> None:
    _write_rig(tmp_path, ("A1", "B2"), count=2)
    with pytest.raises(RigError, match=r"of 2 devices: .*A1 in c0\.mcap; .*B2 in c1\.mcap"):
        process(read_manifest(tmp_path))


def test_what_fails_is_named_and_the_rest_goes_on(rig: Path) -> None:
    manifest = read_manifest(rig)
    lost = manifest.cells[0].model_copy(update={"recording": "lost.mcap"})
    moved = manifest.cells[2].model_copy(update={"corners_m": None, "distance_m": 2.0})
    cells = (lost, moved, *manifest.cells[4:])
    result = process(Manifest(rig, manifest.rig, cells), bootstraps=5)
    assert "lost.mcap is not there" in result.failures[0].reason
    assert "tape and plate disagree by -0.2" in result.cells[0].faults[-1].text
    assert len(result.used) == 4
    assert "4 of 6 cells are used" in verdict(result)[0]
    assert "not used" in report_html(result)


def test_too_few_cells(rig: Path) -> None:
    manifest = read_manifest(rig)
    with pytest.raises(RigError, match="1 of 1 cells can be used, expected at least 3; record"):
        process(Manifest(rig, manifest.rig, manifest.cells[:1]), bootstraps=5)


def test_indoor_against_outdoor(calibrated: PlateResult) -> None:
    indoor = list(calibrated.cells)
    assert compare_environments(indoor) is None
    sun = [
        replace(cell, cell=cell.cell.model_copy(update={"environment": "outdoor"}))
        for cell in indoor[:2]
    ]
    found = compare_environments([*indoor, *sun])
    assert found is not None
    assert (found.cells, found.sigma_ratio, found.error_m, found.fill) == (2, 1.0, 0.0, 0.0)
    both = replace(calibrated, cells=(*indoor, *sun))
    assert "Outdoors, in 2 cells recorded both ways" in verdict(both)[-1]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "cells: Field required"),
        ("[[cells]]\nrecording = 'a'\ndistance_m = -1\nangle_deg = 0", "cells 1 distance_m: Input"),
        ("[rig]\nplate = 1\n[[cells]]\n", "rig plate: Extra inputs"),
        ("cells = [", "cannot read"),
    ],
)
def test_a_manifest_that_is_wrong(tmp_path: Path, text: str, reason: str) -> None:
    (tmp_path / "plate.toml").write_text(text)
    with pytest.raises(RigError, match=f"plate.toml.*{reason}|{reason}.*plate.toml"):
        read_manifest(tmp_path)


def test_a_table_that_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"has neither plate\.toml nor plate\.csv"):
        read_manifest(tmp_path)
    (tmp_path / "plate.csv").write_text("recording,distance_m,angle_deg\na.mcap,far,0\n")
    with pytest.raises(RigError, match=r"cells 1 distance_m: Input should be a valid number"):
        read_manifest(tmp_path)


def test_a_rig_beside_a_table(tmp_path: Path) -> None:
    (tmp_path / "plate.csv").write_text("recording,distance_m,angle_deg\na.mcap,1,0\n")
    assert read_manifest(tmp_path).rig.plate_width_m == 1.0
    (tmp_path / "rig.toml").write_text("[rig]\nplate_width_m = 0.8\n")
    assert read_manifest(tmp_path / "plate.csv").rig.plate_width_m == 0.8
    (tmp_path / "rig.toml").write_text("[rig]\nplate_width = 0.8\n")
    with pytest.raises(RigError, match=r"rig\.toml: plate_width: Extra inputs"):
        read_manifest(tmp_path)


def test_wrong_use_of_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["calibrate", "plate"]) == 2
    assert "or --session DIR" in capsys.readouterr().err
    (tmp_path / "c0").mkdir()
    (tmp_path / "plate.csv").write_text("recording,distance_m,angle_deg\nc0,1.0,0\n")
    assert cli.main(["calibrate", "plate", str(tmp_path)]) == 2
    assert "is a folder of images; give intrinsics_px under [rig]" in capsys.readouterr().err


def _cells_of(law: str, below: bool = False) -> CellSigmas:
    z, t = (axis.ravel() for axis in np.meshgrid(np.linspace(1.0, 3.0, 4), [0.0, 1.0, 4.0]))
    at = Conditions(z, t, np.where(t > 2.0, 1.5, 0.0))
    sigma = {
        "nguyen": 0.0012 + 0.0019 * (z - 0.4) ** 2 + 1e-4 * t**2 / np.sqrt(z),
        "fankhauser": 0.0012
        + 0.0019 * (z - 0.4) ** 2
        + 1e-4 * t**2 / np.sqrt(z)
        + 5e-4 * at.sun * z**2,
        "khoshelham": 1.425e-3 * z**2,
        "disparity": np.hypot(0.001 + 1e-4 * t**2 / np.sqrt(z), 0.0013 * z**2),
    }[law]
    station = np.unique(z, return_inverse=True)[1]
    is_below = (z < 1.5) & below
    told = np.where(is_below, 1.5 * sigma, sigma)
    return CellSigmas(at, told, np.full(z.size, 0.01), is_below, station)


@pytest.mark.parametrize("law", ["nguyen", "fankhauser", "khoshelham", "disparity"])
def test_each_law_is_found_again_and_becomes_a_model(law: str) -> None:
    cells = _cells_of(law)
    if law != "fankhauser":
        cells = CellSigmas(
            Conditions(cells.at.z_m, cells.at.ratio, 0.0 * cells.at.sun),
            cells.sigma_m,
            cells.error,
            cells.is_below,
            cells.station,
        )
    best = fit_laws(cells)[0]
    assert best.name == law
    assert best.held_out < 0.01
    model = best.as_model(0.002)
    z = np.array([1.2, 2.5])
    sun = 1.0 if law == "fankhauser" else 0.0
    own = best.sigma_m(Conditions(z, 0.0 * z, sun + 0.0 * z))
    expected = np.hypot(own, 0.002 * z**2 / np.sqrt(12.0))
    np.testing.assert_allclose(model.axial_sigma_m(z, 0.0 * z), expected, rtol=1e-6)


def test_one_station_that_tells_sigma_is_no_check() -> None:
    cells = _cells_of("disparity")
    cells.is_below[cells.station > 0] = True
    fits = fit_laws(cells)
    assert not np.isfinite(fits[0].held_out)
    assert fits[0].misfit == min(fit.misfit for fit in fits)


def test_a_bound_pulls_down_only() -> None:
    bounded = fit_laws(_cells_of("disparity", below=True))
    law = next(fit for fit in bounded if fit.name == "disparity")
    np.testing.assert_allclose(law.parameters, [0.001, 1e-4, 0.0013], rtol=0.02)


def test_bias_of_one_station_is_a_constant(calibrated: PlateResult) -> None:
    rig_ = calibrated.manifest.rig
    one = fit_bias(list(calibrated.cells[:2]), rig_)
    assert one.coefficients[1:].tolist() == [0.0, 0.0]
    assert one.held_out_m == 0.0
    with pytest.raises(RigError, match="no cell has a tape reading"):
        fit_bias([], rig_)


def test_the_mapper_finds_a_device_s_calibration_and_refuses_another_s(tmp_path: Path) -> None:
    for name, serial in (("a", "A1"), ("b", "B2")):
        content = {
            "schema": "terravibe/depth-noise",
            "version": 1,
            "device": {"model": "Kinect V1", "serial": serial},
            "model": {"name": name, "axial_offset_m": 0.001},
        }
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    (tmp_path / "inertial.json").write_text('{"schema": "terravibe/inertial"}')
    found = calibration_for(calibrations_in(tmp_path), DeviceIdentity(serial="B2"))
    assert found is not None
    assert found.model.name == "b"
    assert calibration_for(calibrations_in(tmp_path), DeviceIdentity(serial="C3")) is None
    assert calibration_for(calibrations_in(tmp_path), DeviceIdentity()) is None
    found.check_device(DeviceIdentity(serial="B2"))
    found.check_device(DeviceIdentity())
    with pytest.raises(MappingError, match=r"b\.json was measured on Kinect V1 B2, .* is of K A1"):
        found.check_device(DeviceIdentity(model="K", serial="A1"))
    (tmp_path / "c.json").write_text((tmp_path / "b.json").read_text())
    with pytest.raises(MappingError, match=r"b\.json and .*c\.json are both of device B2"):
        calibration_for(calibrations_in(tmp_path), DeviceIdentity(serial="B2"))
    with pytest.raises(MappingError, match="there is no folder"):
        calibration_for(calibrations_in(tmp_path / "none"), DeviceIdentity())


def test_cells_of_one_place_are_told_apart_by_their_recordings(calibrated: PlateResult) -> None:
    first = calibrated.manifest.cells[0]
    twice = replace(calibrated.manifest, cells=(*calibrated.manifest.cells, first))
    failed = CellFailure(first, "no plate: it fell over")
    warnings = cell_warnings(replace(calibrated, manifest=twice, failures=(failed,)))
    assert "1.20 m / 0 deg (c0.mcap): no plate: it fell over" in warnings
    warnings = cell_warnings(replace(calibrated, failures=(failed,)))
    assert "1.20 m / 0 deg: no plate: it fell over" in warnings
