"""What the user reads: notes, progress, tables, verdicts, faults; and the live page."""
