"""What moving does to a map: errors of poses and of the motion between them."""
