"""The rover as a physical body: wheels, soil, drive commands."""
