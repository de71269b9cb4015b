"""The host's side of the protocol: its state machine, settings and heartbeat, and the samples that it puts together."""
