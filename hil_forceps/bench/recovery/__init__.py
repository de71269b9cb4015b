"""Recovery of a damaged recording from its file and its bus log."""
