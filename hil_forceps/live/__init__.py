"""A look at a run while it lasts: a channel in shared memory that the loop never waits for, and a page behind it."""
