"""Tables of other people's: how a text is laid out, what its columns are, and the numbers in SI units."""
