"""drivers: one device each; bytes in, frozen SI samples out, in the chip's own axes.

A driver knows nothing of files being recorded, other devices, rover axes or the wall clock.
"""

# Start-up compares this with "terravibe" to notice another distribution's `drivers`.
DISTRIBUTION = "terravibe"
