"""Ground whose height is known everywhere."""
