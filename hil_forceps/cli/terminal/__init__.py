"""Output on the terminal: notes, progress, tables, verdicts, faults; and the live page."""
