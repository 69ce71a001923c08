"""How a recording is doing, while it runs."""
