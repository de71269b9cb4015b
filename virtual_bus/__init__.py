"""The simulated world: a deterministic bus, a simulated drive, the truth plant."""
