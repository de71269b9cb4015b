"""Diagnosis: what the simulation gets wrong, why, and what mending it gains."""
