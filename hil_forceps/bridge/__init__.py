"""Ports, the service loop and its axes; links, logs, live data, doctor and drive conformance beside it."""
