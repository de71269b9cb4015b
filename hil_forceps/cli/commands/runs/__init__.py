"""Commands that make runs, and commands on recorded runs."""
