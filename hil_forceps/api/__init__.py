"""The Python API, which the command line uses, too: a few functions over the other packages."""
