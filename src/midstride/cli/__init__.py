"""The command line: thin commands over the manager's HTTP API and the planners; the composition root.

Exit status (interfaces.md): 0 the answer is yes or done, 1 the answer is no, with the reason, 2
wrong usage. A user's mistake costs one clear line, never a traceback. Modules are imported when a
command needs them, so that ``midstride --help`` is there at once.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Sequence

INTERRUPTED = 130

# What a command builds lives until its end: looking for garbage after every 700 new objects, Python's default, is a
# fifth of the time of checking a large file, and finds none.
_OBJECTS_BETWEEN_COLLECTIONS = 50_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit status."""
    import click

    from midstride.cli.app import cli
    from midstride.errors import MidstrideError

    gc.set_threshold(_OBJECTS_BETWEEN_COLLECTIONS, *gc.get_threshold()[1:])
    words = list(sys.argv[1:] if arguments is None else arguments)
    _open_what_is_closed()
    try:
        status = cli.main(words, prog_name="midstride", standalone_mode=False)
        sys.stdout.flush()
        return status if isinstance(status, int) else 0
    except click.UsageError as error:
        from midstride.cli.errors import usage

        return usage(error, words)
    except MidstrideError as error:
        from midstride.cli.errors import refused

        return refused(error, words)
    except (click.Abort, KeyboardInterrupt):
        print("\nmidstride: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader has seen enough
        _write_nothing_more()
        return 1
    except OSError as error:
        from midstride.cli.errors import refused_by_the_system

        if error.filename is None:
            _write_nothing_more()
        return refused_by_the_system(error, words)


def _open_what_is_closed() -> None:
    """A standard stream that the caller has closed is None: whoever closes it wants nothing of it."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


def _write_nothing_more() -> None:
    """What is still buffered cannot be written either; the interpreter must not complain of it at its end."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


__all__ = ["main"]
