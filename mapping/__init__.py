"""mapping: a stream of poses and depth frames in, an elevation map with variance out.

Knows nothing of devices or of files that are being recorded.
"""

# Start-up compares this with "terravibe" to notice another distribution's `mapping`.
DISTRIBUTION = "terravibe"
