"""calibration_rigs: recordings of a rig in, a calibration file and a report out.

Knows live devices only through the recorder, and never the simulation.
"""

# Start-up compares this with "terravibe" to notice another distribution's `calibration_rigs`.
DISTRIBUTION = "terravibe"
