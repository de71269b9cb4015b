"""Explanation of a recorded run: its events, what ended it, and likely causes."""
