"""Inertial sensors on a rig that does not move, or moves in known ways: noise, bias, scale."""
