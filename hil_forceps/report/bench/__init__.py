"""Figures of the bench."""
