"""Settings of memory allocation for long computations."""

import ctypes
import gc
import sys

COLLECTION_THRESHOLD = 100_000  # allocations between two runs of the garbage collector; 700 by default

M_TRIM_THRESHOLD, M_MMAP_MAX, M_ARENA_MAX = -1, -4, -8  # mallopt(3)


def keep_pages() -> None:
    """Keep freed memory in the process, and run the garbage collector seldom.

    By default glibc returns large arrays to the system at once. Where the system allocates pages slowly, as in virtual
    machines, this costs a sixth of the time of a diagnosis. The garbage collector costs time because each run scans
    all loaded objects; a diagnosis makes few cycles.
    """
    gc.freeze()
    gc.set_threshold(COLLECTION_THRESHOLD)
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # the C library musl has none
    if mallopt is not None:
        for what, value in ((M_MMAP_MAX, 0), (M_TRIM_THRESHOLD, -1), (M_ARENA_MAX, 1)):
            mallopt(what, value)
