"""New recordings made of parts of others."""
