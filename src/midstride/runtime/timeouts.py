"""A deadline round what is awaited: ``async with within(seconds)``.

Not ``asyncio.wait_for``: up to Python 3.11 it forgets that it was cancelled where that meets what it waits for at its
end (CPython issue 81839), and a manager that was told to end would go on. ruff refuses it in the package.
"""

from __future__ import annotations

import sys

if sys.version_info >= (3, 11):
    from asyncio import timeout as within
else:
    from async_timeout import timeout as within

# `within` raises asyncio.TimeoutError, which is another class than TimeoutError up to Python 3.10.
__all__ = ["within"]
