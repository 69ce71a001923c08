"""Ego-motion by Monte Carlo, on rough ground, and its cost, beside the paper's equations.

    python benchmarks/ego_motion.py [--runs N] [--drives N] [--processes N] [--json FILE]

20 s, 3.1 m in three legs from stop to stop, flat or over bumps of 3 degrees in roll and pitch.
Accelerometer 0.05 m/s^2/rtHz and 0.02 m/s^2 bias at 1 kHz, gyro bias 0.01 rad/s and 5e-4 rad/s/rtHz
at 400 Hz, wheel scale 2 % at 50 Hz; all errors are drawn anew for every run. While it drives the
chassis vibrates by 1 m/s^2 RMS per axis at 0.3 m/s, give or take a fifth from run to run.

"vibration + ZUPT" has accelerations alone, "vibration + gyro" no wheels; every run is of a seed of
its own, so that the number of processes changes nothing. The paper's equations and "vibration +
ZUPT" are found from a quarter of the runs. NEES is that of x, y and yaw, over its 3 degrees of
freedom, at the end of the run; its 95 % bounds are those of chi-square. Then the yaw of a perfect
yaw-only gyro after 30 s of simulated drives on rough ground, integrated as it is and by the filter,
which adds what the changing pitch does to it; and the filter's cost as CPU time of the thread over
the length of the drive.
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where mapping.py would hide the package `mapping`.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import math
import time
from collections.abc import Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from benchmarks.inertial_drive import (
    ACCELERATION_DENSITY,
    GYRO_DENSITY,
    SECONDS,
    SPEED_M_S,
    VIBRATION,
    VIBRATION_SPREAD,
    WHEEL_SCALE,
    Truth,
    drive,
    in_order,
    inertial_samples,
    measured_force,
    measured_rate,
    stamp_ns,
    wheel_samples,
)
from drivers.samples import AccelerationSample, Sample, WheelTwistSample, YawRateSample
from mapping.ego_motion.ego_motion import EgoMotion
from mapping.ego_motion.paper2019 import paper_path
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.ego_motion.tilt import angles
from simulation.scenarios import make_scenario
from simulation.vehicle.vehicle_run import simulate_vehicle

Float64Array = NDArray[np.float64]

_METHODS = ("paper2019", "vibration + ZUPT", "vibration + gyro", "gyro + wheels")
_EVERY = 4  # of the runs, for the methods that are there for comparison

_UNOBSERVED = """\
Without wheels the distance cannot be observed: an accelerometer does not tell a slope from an
acceleration. What bounds it are stops, and ground whose slope the roll or seconds of leaning
betray. With wheels their scale cannot, nor wheels that spin alike on both sides. x, y and yaw
drift always; without a gyro yaw is a guess."""

_SETTINGS = EgoMotionSettings(
    gyro_delay_s=0.0,
    wheels_delay_s=0.0,
    acceleration_delay_s=0.0,
    gyro_noise_rad_s_per_sqrt_hz=GYRO_DENSITY,
    wheel_scale=WHEEL_SCALE,
    # In these drives neither bias nor wheels wander, and rest is rest.
    gyro_bias_walk_rad_s_per_sqrt_s=0.0,
    zero_rate_rad_s=2e-4,
    turn_walk_rad_s2_per_sqrt_hz=0.1,
    slip=0.001,
    lateral_slip_ratio=0.0005,
    vertical_walk_ratio=0.0005,
    # Their noise is white: this is what the window leaves of it.
    levelling_sigma_ratio=0.2,
    vibration_m_s2_per_m_s=math.sqrt(3.0) * VIBRATION / SPEED_M_S,
    vibration_scale=VIBRATION_SPREAD,
    # The ground is level wherever it has no bumps; ramps of 0.5 m/s^2 take a third of a leg.
    ground_tilt_rad=0.002,
    ground_walk_rad_per_sqrt_s=0.0005,
    acceleration_m_s2=0.3,
)


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table."""

    ground: str
    method: str
    runs: int
    horizontal_rmse_m: float
    yaw_rmse_deg: float
    nees_per_dof: float
    nees_low: float
    nees_high: float


def end_error(
    samples: Sequence[Sample], truth: Truth, settings: EgoMotionSettings
) -> tuple[Float64Array, Float64Array]:
    """Return the error of x, y and yaw at the end, and its (3, 3) covariance."""
    ego = EgoMotion(settings)
    for sample in samples:
        ego.add(sample)
    ego.finish()
    end_ns = stamp_ns(SECONDS - 0.1)
    pose = ego.pose_at(end_ns)
    if pose is None:
        raise RuntimeError("no pose at the end")
    _, pitch, yaw = angles(pose.transform.rotation)
    j = np.zeros((3, 6))
    j[0, 0] = j[1, 1] = j[2, 5] = 1.0
    j[2, 3], j[2, 4] = math.cos(yaw) * math.tan(pitch), math.sin(yaw) * math.tan(pitch)
    true = truth.position_m[-1]
    turned = math.remainder(yaw - truth.yaw_rad[-1], 2.0 * math.pi)
    error = np.array([*(pose.transform.translation_m - true)[:2], turned])
    return error, j @ pose.covariance @ j.T


def paper_error(
    truth: Truth, force: Float64Array, rate: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return the same of the paper's equations, at the gyro's rate, gravity taken off at rest."""
    a = force[: rate.size * 5 // 2].reshape(-1, 5, 3).mean(axis=1)  # 5 ms
    a = a - a[:400].mean(axis=0)
    slow = rate[::2]
    count = min(len(a), len(slow) - 1)
    noise = np.diag([ACCELERATION_DENSITY**2 * 100.0] * 3 + [(GYRO_DENSITY / 0.005) ** 2 * 100.0])
    state = paper_path(a[:count], slow[: count + 1], 0.005, noise)
    true = np.array([*truth.position_m[-1, :2], truth.yaw_rad[-1]])
    error = np.array([*state.position_m[:2], state.yaw_rad]) - true
    kept = [0, 1, 3]
    return error, state.covariance[np.ix_(kept, kept)]


Found = tuple[Float64Array, Float64Array]


def one_run(run: int, bump_rad: float) -> dict[str, Found]:
    """Return errors and covariances at the end of one run, by method."""
    random = np.random.default_rng([7, run])
    truth = drive(bump_rad, random)
    force, rate = measured_force(truth, random), measured_rate(truth, random)
    inertial = inertial_samples(force, rate)
    both = in_order(inertial, wheel_samples(truth, random))
    found = {
        "vibration + gyro": end_error(inertial, truth, _SETTINGS),
        "gyro + wheels": end_error(both, truth, _SETTINGS),
    }
    if run % _EVERY == 0:
        alone = [sample for sample in inertial if isinstance(sample, AccelerationSample)]
        found["paper2019"] = paper_error(truth, force, rate)
        found["vibration + ZUPT"] = end_error(alone, truth, _SETTINGS)
    return found


def monte_carlo(pool: Executor, ground: str, bump_rad: float, runs: int) -> list[Row]:
    """Return the rows of one ground."""
    found = list(pool.map(partial(one_run, bump_rad=bump_rad), range(runs), chunksize=4))
    return [_row(ground, method, [f[method] for f in found if method in f]) for method in _METHODS]


def rough_yaw_deg(pool: Executor, drives: int) -> tuple[float, float]:
    """Return the RMS error of a perfect yaw-only gyro's yaw: integrated, and by the filter."""
    errors = np.array(list(pool.map(_one_rough_yaw, range(1, drives + 1))))
    plain, filtered = np.degrees(np.sqrt((errors**2).mean(axis=0)))
    return float(plain), float(filtered)


def _one_rough_yaw(seed: int) -> tuple[float, float]:
    settings = EgoMotionSettings(
        gyro_bias_rad_s=1e-6,
        gyro_bias_walk_rad_s_per_sqrt_s=0.0,
        gyro_noise_rad_s_per_sqrt_hz=1e-5,
        gyro_delay_s=0.0025,
    )
    scenario = make_scenario("rough", seed, 30.0)
    drive_ = simulate_vehicle(scenario.ground, scenario.commands, 30.0, seed, scenario.options)
    motion, end = drive_.motion, 29_500
    rate = motion.body_rate_rad_s[:, 2]
    rates = [
        YawRateSample(motion.start_ns + 5 * (i + 1) * 10**6, w, None, None, i)
        for i, w in enumerate(rate[: rate.size // 5 * 5].reshape(-1, 5).mean(axis=1).tolist())
    ]
    others = [s for s in drive_.samples() if isinstance(s, AccelerationSample | WheelTwistSample)]
    ego = EgoMotion(settings)
    for sample in in_order(others, rates):
        ego.add(sample)
    ego.finish()
    pose = ego.pose_at(motion.start_ns + end * 10**6)
    if pose is None:
        raise RuntimeError("no pose at the end")
    turns = Rotation.from_quat(motion.quat_wxyz[[0, end]], scalar_first=True).as_matrix()
    first, last = (angles(turn)[2] for turn in turns)
    true = last - first
    found = angles(pose.transform.rotation)[2]
    plain = float(rate[:end].sum()) * 0.001
    return math.remainder(plain - true, 2 * math.pi), math.remainder(found - true, 2 * math.pi)


def cost_share(repeats: int = 5) -> float:
    """Return the CPU time of the filter over the length of a drive, median."""
    random = np.random.default_rng(1)
    truth = drive(math.radians(3.0), random)
    force, rate = measured_force(truth, random), measured_rate(truth, random)
    samples = in_order(inertial_samples(force, rate), wheel_samples(truth, random))
    shares = []
    for _ in range(repeats):
        ego, begin = EgoMotion(_SETTINGS), time.thread_time()
        for sample in samples:
            ego.add(sample)
        ego.finish()
        shares.append((time.thread_time() - begin) / SECONDS)
    return float(np.median(shares))


def _row(ground: str, method: str, pairs: list[tuple[Float64Array, Float64Array]]) -> Row:
    errors = np.array([error for error, _ in pairs])
    nees = [float(e @ np.linalg.solve(p, e)) / 3.0 for e, p in pairs]
    low, high = chi2.ppf([0.025, 0.975], 3 * len(pairs)) / (3 * len(pairs))
    return Row(
        ground=ground,
        method=method,
        runs=len(pairs),
        horizontal_rmse_m=float(np.sqrt((errors[:, :2] ** 2).sum(axis=1).mean())),
        yaw_rmse_deg=float(np.degrees(np.sqrt((errors[:, 2] ** 2).mean()))),
        nees_per_dof=float(np.mean(nees)),
        nees_low=float(low),
        nees_high=float(high),
    )


def print_table(rows: Sequence[Row]) -> None:
    """Print the methods side by side."""
    print("ground method              runs  horizontal       yaw  NEES/dof   95 %")
    for r in rows:
        print(
            f"{r.ground:<7}{r.method:<18}{r.runs:>6}{r.horizontal_rmse_m:>10.3f} m"
            f"{r.yaw_rmse_deg:>6.2f} deg{r.nees_per_dof:>10.3g}   "
            f"{r.nees_low:.2f} to {r.nees_high:.2f}"
        )
    print(_UNOBSERVED)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--drives", type=int, default=8, help="on rough ground")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    with ProcessPoolExecutor(options.processes) as pool:
        rows = monte_carlo(pool, "flat", 0.0, options.runs)
        rows += monte_carlo(pool, "bumps", math.radians(3.0), options.runs)
        print_table(rows)
        plain_deg, filtered_deg = rough_yaw_deg(pool, options.drives)
    print(
        f"perfect yaw-only gyro, {options.drives} rough drives of 30 s: {plain_deg:.2f} deg RMS "
        f"integrated, {filtered_deg:.2f} deg by the filter"
    )
    share = cost_share()
    print(f"filter at 1 kHz + 400 Hz + 50 Hz: {100.0 * share:.1f} % of one core")
    if options.json:
        found = {
            "monte_carlo": [asdict(row) for row in rows],
            "rough_yaw_deg": {"integrated": plain_deg, "filter": filtered_deg},
            "cost_share": share,
        }
        options.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
