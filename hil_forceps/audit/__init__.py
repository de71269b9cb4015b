"""What can be said of the data themselves, before any physics: stamps, channels, law, balances, strokes."""
