"""rover.toml: what it may say, and what the recorder is made of by it."""
