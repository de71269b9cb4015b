"""Measured data of a surgical tool: the files of a data set, and the runs in them."""
