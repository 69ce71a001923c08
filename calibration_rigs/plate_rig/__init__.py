"""The plate rig: a flat plate at known distances and angles in front of a depth camera."""
