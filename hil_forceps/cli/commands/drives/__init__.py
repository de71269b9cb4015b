"""Commands about a drive and its line."""
