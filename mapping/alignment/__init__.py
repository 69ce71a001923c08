"""Where a depth frame was taken from, read off the map that earlier frames built."""
