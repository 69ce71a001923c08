"""zarr keeps a thread for the life of the process; here it may not outlive a test."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
from zarr.core.sync import cleanup_resources


@pytest.fixture(autouse=True)
def zarr_stops() -> Iterator[None]:
    yield
    cleanup_resources()
    for thread in threading.enumerate():
        if thread.name.startswith("asyncio_"):
            thread.join(5.0)
