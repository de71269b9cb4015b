"""What the memory of a long computation is got from."""

import ctypes
import gc
import sys

COLLECTION_THRESHOLD = 100_000  # objects made between two looks for cycles of them; 700 by default

M_TRIM_THRESHOLD, M_MMAP_MAX, M_ARENA_MAX = -1, -4, -8  # mallopt(3)


def keep_pages() -> None:
    """Have the process keep the memory it frees: one matrix after the other then has pages that are there already.

    Large arrays are otherwise given back to the system at once. Where that gives out pages slowly, as in virtual
    machines, a sixth of a diagnosis is waiting for them (with the C library of GNU only). And cycles of objects are
    looked for seldom: a diagnosis makes few, and looks through all that is loaded each time.
    """
    gc.freeze()
    gc.set_threshold(COLLECTION_THRESHOLD)
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # the C library musl has none
    if mallopt is not None:
        for what, value in ((M_MMAP_MAX, 0), (M_TRIM_THRESHOLD, -1), (M_ARENA_MAX, 1)):
            mallopt(what, value)
