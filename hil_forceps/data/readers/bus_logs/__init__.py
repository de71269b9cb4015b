"""Frames out of the bus logs that other programs write, one file a format; and the runs in them.

Own parsers: python-can's (4.6.1) go round for ever on a BLF object of size 0, take ASC's relative stamps for absolute,
skip in silence or end with a Python error what is damaged, and tell no line (docs/decisions/0015). They are the referee
in the tests.
"""
