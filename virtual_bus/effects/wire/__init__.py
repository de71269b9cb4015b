"""Effects of the wire and of what winds it."""
