"""Which poses a map is made with."""

from __future__ import annotations

from typing import Literal

PoseSourceName = Literal["mocap", "mocap+alignment", "ego-motion", "ego-motion+alignment"]
TiltSource = Literal["levelled", "level"]
