"""Triaxial vibration sensors on a serial port, described by profile files."""
