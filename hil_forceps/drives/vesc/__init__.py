"""A VESC over CAN."""
