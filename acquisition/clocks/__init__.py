"""The host's clocks and the devices' counters."""
