"""What a live page gets of a running service, and what it asks of it."""
