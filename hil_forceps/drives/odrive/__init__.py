"""An ODrive over CANSimple."""
