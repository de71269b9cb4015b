"""Conformance of a drive, told from outside: whatever answers at a port, real or simulated, run through the spec.

Without IO: the transport and its clock come in as a `port.Port`. `suite.Suite` runs the checks, `report` writes down
what came of it.
"""
