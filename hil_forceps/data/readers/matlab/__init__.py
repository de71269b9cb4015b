"""MATLAB files of version 5 to 7: their arrays, and the runs in them."""
