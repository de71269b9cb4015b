"""What to look at before the first motion: this machine, the line, the rig, and the drive that answers.

Each check says what it looked at, what it found, and what to type where that isn't as it should be. Nothing here moves,
enables or sets anything. docs/doctor.md has the table of all checks with their thresholds.
"""
