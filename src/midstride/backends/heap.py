"""The memory of a process that runs for weeks: what is free in its heap is given back to the system.

glibc keeps freed memory in each thread's arena. After thousands of replacements, a manager held megabytes of it
(docs/benchmarks.md).
"""

from __future__ import annotations

import ctypes


def give_back() -> None:
    """Does nothing under a C library that has no `malloc_trim`. Takes about 0.1 ms where little is free."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(ctypes.c_size_t(0))
