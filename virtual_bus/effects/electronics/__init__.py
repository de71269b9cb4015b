"""Effects of amplifier, sensors and timing."""
