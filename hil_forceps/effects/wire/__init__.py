"""Effects of the wire, its pulleys and levers."""
