"""An axis that one motor moves, and nothing else on it: its inverse model, and its motion when a force drives it."""
