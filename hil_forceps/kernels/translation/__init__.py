"""Kernels as C99: the same Python text that numba compiles, one C function for each kernel and argument types."""
