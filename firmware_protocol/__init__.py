"""The wire: messages, codec, framing and the sans-IO state machines of both ends."""
