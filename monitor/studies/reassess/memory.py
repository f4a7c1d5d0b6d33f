"""The memory of a worker: what one recording has used is kept for the next one."""

import ctypes
import sys
from functools import cache

KEEP_BYTES = 512 * 1024 * 1024  # at the top of the heap; more goes back to the system
MAPPED_BYTES = 64 * 1024 * 1024  # arrays up to this size come from the heap: those of a recording are 2 to 30 MB
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # malloc.h of the GNU C library


@cache
def keep_memory() -> bool:
    """Let the C library keep freed memory of this process; whether it was told so.

    Dask starts workers with MALLOC_TRIM_THRESHOLD_=65536, by which each array of a recording is given back and asked for again: the
    kernel then clears a million pages a minute, which takes as long as four fifths of the identification itself.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):  # another C library
        return False
    return bool(mallopt(M_MMAP_THRESHOLD, MAPPED_BYTES)) and bool(mallopt(M_TRIM_THRESHOLD, KEEP_BYTES))
