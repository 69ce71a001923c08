"""The ROS 2 types that the stream uses: those of the distribution, and our own (`msg/*.msg`)."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

_OWN_PACKAGE = "terravibe_msgs"


@cache
def typestore() -> Typestore:
    """Return the types by name, "package/msg/Name"."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for entry in sorted((files("acquisition") / "msg").iterdir(), key=lambda entry: entry.name):
        name = f"{_OWN_PACKAGE}/msg/{entry.name.removesuffix('.msg')}"
        store.register(get_types_from_msg(entry.read_text(encoding="utf-8"), name))
    return store
