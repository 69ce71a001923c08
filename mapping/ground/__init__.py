"""What follows from the heights: slope and kin, gaps closed."""
