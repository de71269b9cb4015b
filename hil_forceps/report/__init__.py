"""Figures and pages of results; no computation."""
