"""What is watched while a drive runs: its direction, a runaway, and whether one drive answers or two."""
