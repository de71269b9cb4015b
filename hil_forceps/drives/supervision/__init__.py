"""What is watched while a drive runs: direction, following error, runaway, and whether one drive answers or two."""
