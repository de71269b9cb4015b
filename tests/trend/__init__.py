"""Simulated sessions of an instrument that changes, for the tests and the bench of `trend`."""
