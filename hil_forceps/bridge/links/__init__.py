"""Links to a drive: python-can interfaces, serial ports and UDP, and what opens them."""
