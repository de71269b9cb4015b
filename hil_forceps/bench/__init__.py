"""Runs of the bench, their metrics and summary."""
