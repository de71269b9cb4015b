"""Diagnosis: what a simulation gets wrong about measured runs, why, and what mending it gains. No IO, no clock."""
