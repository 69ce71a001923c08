"""Wheel odometry from the vehicle's CAN bus."""
