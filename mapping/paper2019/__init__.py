"""The map of the 2019 paper as printed, faults included: to compare with, not to drive by."""
