"""Files of every kind, sound and damaged, and what must hold of whatever a reader makes of them."""
