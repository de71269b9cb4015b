"""Numeric functions, compiled: by numba for calls from sample to sample, by the C compiler for whole runs."""
