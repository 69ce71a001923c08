"""What must not stay in a map: things that have left, the rover itself, and what hangs above it."""
