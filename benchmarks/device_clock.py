"""How exact and how fast a device's counter is translated to the host's clock.

    python benchmarks/device_clock.py [--seconds 600] [--seeds 5] [--json FILE]

The device is the simulated Kinect: 60 MHz counter of 32 bits, 40 ppm fast, 30 Hz, 8 ms least
delay (subtracted as the calibrated constant), 2 ms jitter, 1 % stalls of 20 to 80 ms. Errors are
translated minus true time: from the first message, after 10 s, and after a full window of 60 s.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from acquisition.clocks.device_clock import DeviceClock, DeviceClockSettings
from tests.fakes.clocks import Int64Array, kinect

SETTINGS = DeviceClockSettings(60e6, 1 << 32, min_delay_ns=8_000_000)
RATE_HZ = 30


def run(seed: int, seconds: float) -> dict[str, float]:
    """Return the figures of one run."""
    messages = kinect(seed, seconds=seconds, rate_hz=RATE_HZ)
    ticks = (messages.ticks % (1 << 32)).tolist()
    pairs = list(zip(ticks, messages.arrival_ns.tolist(), strict=True))
    clock = DeviceClock(SETTINGS)
    start_s = time.perf_counter()
    times_ns = [clock.translate(*pair) for pair in pairs]
    update_us = (time.perf_counter() - start_s) / len(pairs) * 1e6
    error_ns = np.array(times_ns) - messages.event_ns
    figures = {"update_us": update_us, "skew_ppm": clock.skew_ppm}
    arrival_ns = messages.arrival_ns - messages.event_ns - SETTINGS.min_delay_ns
    for name, errors_ns, skip_s in (
        ("arrival", arrival_ns, 0),
        ("all", error_ns, 0),
        ("after_10s", error_ns, 10),
        ("after_60s", error_ns, 60),
    ):
        figures |= _spread(name, errors_ns[skip_s * RATE_HZ :])
    return figures


def _spread(name: str, error_ns: Int64Array) -> dict[str, float]:
    error_ms = error_ns * 1e-6
    return {
        f"{name}_std_ms": float(error_ms.std()),
        f"{name}_p99_ms": float(np.quantile(np.abs(error_ms), 0.99)),
    }


def main() -> None:
    """Print one column for each seed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=600.0, help="length of each run")
    parser.add_argument("--seeds", type=int, default=5, help="number of runs")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments = parser.parse_args()
    runs = [run(seed, arguments.seconds) for seed in range(arguments.seeds)]
    for name in runs[0]:
        print(f"{name:<18}" + "".join(f"{figures[name]:>10.4f}" for figures in runs))
    if arguments.json:
        arguments.json.write_text(json.dumps(runs, indent=2) + "\n")


if __name__ == "__main__":
    main()
