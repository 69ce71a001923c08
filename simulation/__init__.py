"""simulation: a world whose truth is known, and simulated devices that look like drivers.

Knows the drivers' sample types and nothing of the mapper; only the command line, tests and
benchmarks import it.
"""

# Start-up compares this with "terravibe" to notice another distribution's `simulation`.
DISTRIBUTION = "terravibe"
