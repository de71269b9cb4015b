"""Effects of the motor: its friction, its torque."""
