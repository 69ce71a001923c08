"""The commands that record, inspect and edit recordings."""
