"""Where libOpenNI2 and its drivers are on this machine.

Debian and Ubuntu: `libopenni2-0` is the library, `libopenni2-dev` adds the link without a version
that the Python package `openni` loads. Nothing here loads native code.
"""

from __future__ import annotations

import os
import sysconfig
from collections.abc import Iterable
from pathlib import Path

from drivers.errors import DriverError

INSTALL_ADVICE = "run 'apt install libopenni2-0 libopenni2-dev' or set OPENNI2_REDIST64"
FREENECT_ADVICE = (
    "build libFreenectDriver.so.0 from libfreenect (cmake -DBUILD_OPENNI2_DRIVER=ON) and copy it "
    "to that folder, see docs/devices/kinect.md"
)

_LIBRARY = "libOpenNI2.so"
_FREENECT_DRIVER = "libFreenectDriver.so*"


def usual_folders() -> list[Path]:
    """Return the folders that are searched, the environment's choice first."""
    chosen = os.environ.get("OPENNI2_REDIST64") or os.environ.get("OPENNI2_REDIST")
    triplet = sysconfig.get_config_var("MULTIARCH")
    system = [f"/usr/lib/{triplet}"] if triplet else []
    folders = [*system, "/usr/lib", "/usr/local/lib", "/usr/lib64"]
    return [Path(folder) for folder in ([chosen] if chosen else folders)]


def find_library(folders: Iterable[Path]) -> Path:
    """Return the first of the folders that holds a loadable libOpenNI2.

    Raises:
        DriverError: none does; the message says which packages to install.
    """
    searched = list(folders)
    for folder in searched:
        if (folder / _LIBRARY).is_file():
            return folder
    for folder in searched:
        if any(folder.glob(f"{_LIBRARY}.*")):
            raise DriverError(
                f"{folder} has libOpenNI2 but not the link {_LIBRARY}; expected both, "
                "run 'apt install libopenni2-dev'"
            )
    raise DriverError(
        f"libOpenNI2 is not in {', '.join(map(str, searched))}; expected {_LIBRARY}, "
        f"{INSTALL_ADVICE}"
    )


def driver_folder(library_folder: Path) -> Path:
    """Return the folder from which that libOpenNI2 loads its device drivers."""
    return library_folder / "OpenNI2" / "Drivers"


def has_freenect_driver(library_folder: Path) -> bool:
    """Tell whether the driver for Kinect V1 is installed."""
    return any(driver_folder(library_folder).glob(_FREENECT_DRIVER))
