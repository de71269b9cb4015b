"""Diagnosis: what a simulation gets wrong about measured runs, why, and what mending it gains. Pure: no IO, no clock."""
