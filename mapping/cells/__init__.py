"""The cells of a map, where they live, and one frame's update of them."""
