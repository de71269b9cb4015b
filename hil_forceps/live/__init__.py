"""Live view of a run: a channel in shared memory that the loop never waits for, and a page that reads it."""
