"""The ROS 2 types of the stream: those of ROS 2 Humble, and those that msg/PACKAGE/NAME.msg define.

A further file in msg/ is a further type, PACKAGE/msg/NAME; nothing else has to know.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

# A message of a type that msg/ defines. Its class is made at run time, so that a type checker
# cannot know its fields; the round-trip tests know them.
RosMessage: TypeAlias = Any

IMU_TYPE = "sensor_msgs/msg/Imu"

_DEFINITIONS = Path(__file__).with_name("msg")


@cache
def typestore() -> Typestore:
    """Return the types; the same object every time."""
    definitions: Typesdict = {}
    for file in sorted(_DEFINITIONS.glob("*/*.msg")):
        ros_type = f"{file.parent.name}/msg/{file.stem}"
        definitions |= get_types_from_msg(file.read_text(encoding="utf-8"), ros_type)
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(definitions)
    return store


def ros_class(ros_type: str) -> Callable[..., object]:
    """Return the class of a type that msg/ defines; it takes the fields in order."""
    return typestore().types[ros_type]
