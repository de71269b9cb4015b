"""Recorded runs: the table of one run, also on even rows, the readers that fill it, and the project's own recording."""
