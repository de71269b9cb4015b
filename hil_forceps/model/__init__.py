"""The simulation that gets diagnosed: scalar step functions."""
