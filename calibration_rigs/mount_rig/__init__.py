"""Where the depth camera sits on the rover, and how wide the rover steers."""
