"""A first rig from what somebody knows of motor, drive, encoder and pulleys, each value with where it is from."""
