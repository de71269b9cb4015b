"""Ports, the service loop, its axes, bus log and flight recorder; links, doctor and drive conformance beside it."""
