"""Ports, adapters, the service loop, recording."""
