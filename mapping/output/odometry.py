"""The poses of a run as a recording of its own: /odom and /tf."""

from __future__ import annotations
