"""Checks before the first motion: computer, line, rig file, and the drive that answers.

Each check has what it examined, what it found, and a remedy if it did not pass. No check moves, enables or sets
anything. docs/doctor.md has the table of all checks with their thresholds.
"""
