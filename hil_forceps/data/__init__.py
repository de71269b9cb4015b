"""Recorded runs: the table of one run, the readers that fill it, and the project's own recording."""
