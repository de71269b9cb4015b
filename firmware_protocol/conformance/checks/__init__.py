"""The checks, by chapter of the spec; importing this package registers them all."""

from firmware_protocol.conformance.checks import (
    discovery,
    enabling,
    faults,
    fd,
    frames,
    heartbeats,
    ids,
    measurements,
    parameters,
    references,
    sequences,
    serial_line,
    watchdog,
)

__all__ = [
    "discovery",
    "enabling",
    "faults",
    "fd",
    "frames",
    "heartbeats",
    "ids",
    "measurements",
    "parameters",
    "references",
    "sequences",
    "serial_line",
    "watchdog",
]
