"""Many sessions of one or several instruments in a folder: which files they are, of which instrument, from when."""
