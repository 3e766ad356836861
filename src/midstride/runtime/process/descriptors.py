"""The number of files that a manager may have open: more than the user's soft limit, which what it starts keeps.

A manager has two open for each component, and the usual soft limit is 1024. That is meant for programs that use
select(), which fails beyond it: whether those that a manager starts do so is not known.
"""

from __future__ import annotations

import resource
from contextlib import suppress
from typing import Final

# No more than this: some programs go through all numbers up to their limit, and the hard one may be a billion.
MOST: Final = 65_536

_given: tuple[int, int] | None = None  # the limits that this process was started with, once it has other ones


def raise_limit() -> None:
    """Raise the soft limit of this process towards the hard one."""
    global _given
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST if hard == resource.RLIM_INFINITY else min(hard, MOST)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        _given = soft, hard


def restore_limit(pid: int) -> None:
    """Give a process that has just been started the limits that this one was started with.

    Not before its program is loaded, as the fork of a manager takes some 10 ms more if code is to run in the child: so
    a program that reads its limit at once may read that of the manager.
    """
    if _given is not None:
        with suppress(ProcessLookupError, PermissionError):  # it has exited, or runs as another user by now
            resource.prlimit(pid, resource.RLIMIT_NOFILE, _given)
