"""What the devices of the simulated rover report."""
