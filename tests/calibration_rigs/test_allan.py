"""Allan deviation against published values, and its fit against noise of known coefficients."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration_rigs.errors import RigError
from calibration_rigs.static_rig.allan import AllanFit, allan_curve, fit_allan
from calibration_rigs.static_rig.deviations import KINDS, AtRest, deviation, deviations_csv

# Ten phase points as nine frequencies, and their deviations at 1 and 2 (Riley, Handbook of
# Frequency Stability Analysis, NIST SP 1065, table of the nine-point data set).
NBS14 = np.array([892.0, 809.0, 823.0, 798.0, 671.0, 644.0, 883.0, 903.0, 677.0])
NBS14_DEVIATIONS = {
    "adev": [91.22945, 115.8082],
    "oadev": [91.22945, 85.95287],
    "mdev": [91.22945, 74.78849],
    # Printed as 70.80608; the nine integers give sqrt(210567 / 42) = 70.806073.
    "hdev": [70.80607, 116.7980],
    "tdev": [52.67135, 86.35831],
}
RATE_HZ = 100.0


def _noise(white: float, walk: float, samples: int, seed: int) -> np.ndarray:
    """Return white noise of density `white` and a random walk of density `walk` at 100 Hz."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(0.0, walk / np.sqrt(RATE_HZ), samples)
    return rng.normal(0.0, white * np.sqrt(RATE_HZ), samples) + np.cumsum(steps)


def _fit(white: float, walk: float, samples: int, seed: int) -> AllanFit:
    return fit_allan(allan_curve(_noise(white, walk, samples, seed), RATE_HZ))


def test_the_reference_data_give_their_published_deviations() -> None:
    curve = allan_curve(NBS14, 1.0, np.array([1.0, 2.0]))
    assert curve.deviation.round(5).tolist() == NBS14_DEVIATIONS["oadev"]


@pytest.mark.parametrize("kind", KINDS)
def test_every_deviation_of_the_reference_data_is_the_published_one(kind: str) -> None:
    tau, found = deviation(kind, AtRest(NBS14, 1.0), np.array([1.0, 2.0]))
    assert tau.tolist() == [1.0, 2.0]
    # Seven digits are published; 116.7980 is 116.798 here.
    assert [f"{value:.7g}" for value in found] == [f"{v:.7g}" for v in NBS14_DEVIATIONS[kind]]


def test_the_table_has_every_deviation_of_every_signal() -> None:
    signal = AtRest(_noise(0.01, 0.0, 300, 2), RATE_HZ)
    rows = [line.split(",") for line in deviations_csv({"a": signal, "b": signal}).splitlines()]
    assert rows[0] == ["signal", "deviation", "tau_s", "value"]
    assert {(row[0], row[1]) for row in rows[1:]} == {(n, k) for n in "ab" for k in KINDS}
    assert float(rows[1][2]) == 1.0 / RATE_HZ


def test_white_noise_gives_its_density_within_one_percent() -> None:
    fit = _fit(0.01, 0.0, 400_000, seed=4)
    assert fit.white.value == pytest.approx(0.01, rel=0.01)
    assert not fit.random_walk.is_significant
    assert fit.chi2_per_freedom < 2.0


def test_the_intervals_of_white_noise_hold() -> None:
    inside = 0
    for seed in range(60):
        white = _fit(0.01, 0.0005, 10_000, seed).white
        inside += abs(white.value - 0.01) <= 1.96 * white.sigma
    assert inside >= 52  # 95 % of 60 are 57; fewer than 52 happens once in 200


def test_a_random_walk_is_found_and_its_interval_is_wide() -> None:
    fits = [_fit(0.01, 0.002, 20_000, seed) for seed in range(20)]
    walks = np.array([fit.random_walk.value for fit in fits])
    assert np.mean(walks) == pytest.approx(0.002, rel=0.35)
    inside = [abs(f.random_walk.value - 0.002) < 1.96 * f.random_walk.sigma for f in fits]
    assert sum(inside) >= 16  # 95 % of 20 are 19; fewer than 16 happens once in 400
    assert min(fit.random_walk.sigma for fit in fits) > 0.0002


def test_the_coefficients_make_the_deviations_again() -> None:
    curve = allan_curve(_noise(0.01, 0.002, 50_000, 1), RATE_HZ)
    made = fit_allan(curve).deviation(curve.tau_s)
    assert np.median(np.abs(np.log(made / curve.deviation))) < 0.05


@given(st.floats(1e-6, 1e6), st.floats(1.0, 1e4))
def test_the_deviation_scales_with_the_signal_and_time_with_the_rate(
    factor: float, rate_hz: float
) -> None:
    values = _noise(0.01, 0.0, 200, 7)
    plain, scaled = allan_curve(values, 1.0), allan_curve(values * factor, rate_hz)
    assert scaled.deviation == pytest.approx(plain.deviation * factor, rel=1e-6)
    assert scaled.tau_s == pytest.approx(plain.tau_s / rate_hz, rel=1e-9)
    assert scaled.degrees_of_freedom == pytest.approx(plain.degrees_of_freedom)


def test_a_constant_signal_is_refused() -> None:
    with pytest.raises(RigError, match="does not vary"):
        fit_allan(allan_curve(np.ones(2000), RATE_HZ))


@pytest.mark.parametrize("values", [np.ones(2), np.array([1.0, np.nan, 2.0]), np.ones((4, 2))])
def test_what_is_no_signal_is_refused(values: np.ndarray) -> None:
    with pytest.raises(RigError, match="expected one dimension of finite samples"):
        allan_curve(values, RATE_HZ)
