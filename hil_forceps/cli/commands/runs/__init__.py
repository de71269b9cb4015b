"""Commands that make runs, and those that look at what these recorded."""
