"""Kernels as C99: the same Python text that numba compiles, one C function for each kernel and argument types.

What it doesn't know is refused with its place. Unlike Python, and known: arguments are computed in C's order, so none
of them may change what another reads; a sum goes from first to last, as numba's; who hands over a read-only array must
know that it isn't written to; a variable that is used as a place holds one from 0 on.
"""
