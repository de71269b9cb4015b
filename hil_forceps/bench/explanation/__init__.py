"""The course of a recorded run in plain sentences: what happened, what ended it, what may be behind it."""
