"""Figures of models fitted to measured runs."""
