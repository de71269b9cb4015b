"""The drive's side of the protocol: its state machine, settings and parameter values, and its answer to DISCOVER."""
