"""Samples to and from ROS 2 messages."""
