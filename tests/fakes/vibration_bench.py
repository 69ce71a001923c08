"""What the tests of the vibration sensor share."""

from __future__ import annotations

from pathlib import Path

from drivers.samples import VibrationSample
from drivers.vibration.profile import load_profile
from drivers.vibration.sensor import VibrationSensor
from tests.fakes.vibration_bytes import frame_of

PROFILE_FOLDER = Path(__file__).parents[2] / "drivers" / "vibration" / "profiles"

# What an AFT601D would stream if its layout were the assumed one.
AFT601D_FRAMES = [
    frame_of(
        load_profile("aft601d"),
        {"displacement": (n, 2 * n, 3 * n), "frequency": (370, 371, 372)},
    )
    for n in range(1, 100)
]


def hasty_profile(folder: Path, name: str) -> Path:
    """Write a shipped profile with less patience, for tests in which nothing answers."""
    text = (PROFILE_FOLDER / f"{name}.toml").read_text()
    for patience in ("1.0", "2.0"):
        text = text.replace(f"identify_within_s = {patience}", "identify_within_s = 0.4")
    path = folder / f"{name}.toml"
    path.write_text(text.replace("reply_within_s = 0.2", "reply_within_s = 0.15"))
    return path


def vibrations(sensor: VibrationSensor, count: int) -> list[VibrationSample]:
    """Return at least that many vibration samples; a silent device fails the test."""
    found: list[VibrationSample] = []
    while len(found) < count:
        samples = sensor.read(2.0)
        assert samples, "the device fell silent"
        found += [sample for sample in samples if isinstance(sample, VibrationSample)]
    return found


def descriptors() -> int:
    """Return how many files this process has open."""
    return len(list(Path("/proc/self/fd").iterdir()))
