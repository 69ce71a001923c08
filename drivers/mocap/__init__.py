"""Motion capture systems."""
