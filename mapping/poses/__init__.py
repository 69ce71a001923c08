"""Where the poses of the depth frames come from."""
