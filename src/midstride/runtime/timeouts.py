"""Time-outs: ``async with within(seconds)``.

Use it instead of ``asyncio.wait_for``, which up to Python 3.11 loses a cancellation that arrives just as the awaited
task completes (CPython issue 81839): a manager that is shutting down would not stop. ruff rejects ``wait_for`` here.
"""

from __future__ import annotations

import sys

if sys.version_info >= (3, 11):
    from asyncio import timeout as within
else:
    from async_timeout import timeout as within

# `within` raises asyncio.TimeoutError, which is not TimeoutError up to Python 3.10.
__all__ = ["within"]
