"""Depth cameras: image folders, and OpenNI2 in a process of its own."""
