"""Figures out of results; no computing."""
