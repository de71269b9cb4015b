"""Effects of the jaw."""
