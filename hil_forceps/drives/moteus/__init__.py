"""A moteus over its registers on CAN FD."""
