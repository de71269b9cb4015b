"""Commands for a drive and its line."""
