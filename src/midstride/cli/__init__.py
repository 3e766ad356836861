"""The command line: thin commands over the manager's HTTP API and the planners; the composition root.

Exit status: 0 yes or done, 1 no, with the reason, 2 wrong usage, 130 interrupted. A user's mistake costs one clear
line, never a traceback. Modules are imported when a command needs them, so that ``midstride --help`` stays fast.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Sequence

PUBLIC = "Demo DemoEnvironment cancelled_by_signals demo_environment matching"

# A command keeps nearly every object until it exits. Collecting garbage after every 700 new objects, Python's default,
# takes a fifth of the time of checking a large file and finds nothing.
_GC_THRESHOLD = 50_000


def main(arguments: Sequence[str] | None = None, program: str = "midstride") -> int:
    """Run one command and return its exit status. Help and errors about its use name ``program``."""
    from midstride.cli.output import printable_output

    gc.set_threshold(_GC_THRESHOLD, *gc.get_threshold()[1:])
    words = list(sys.argv[1:] if arguments is None else arguments)
    _replace_closed_streams()
    if (instruction := os.environ.get("_MIDSTRIDE_COMPLETE")) is not None:
        from midstride.cli.command_list import cli
        from midstride.cli.shell_completion import complete

        return complete(cli, instruction)
    with printable_output():
        return _run(words, program)


def _run(words: list[str], program: str) -> int:
    import click

    from midstride.cli.command_list import cli
    from midstride.cli.output import INTERRUPTED
    from midstride.errors import MidstrideError

    try:
        status = cli.main(words, prog_name=program, standalone_mode=False)
        sys.stdout.flush()
        return status if isinstance(status, int) else 0
    except (click.Abort, KeyboardInterrupt):
        print(f"\n{program}: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader has closed the pipe, as `head` does
        _discard_output()
        return 1
    except (click.UsageError, MidstrideError, OSError) as error:
        from midstride.cli.error_output import report

        if isinstance(error, OSError) and error.filename is None:
            _discard_output()
        return report(error, words, program)


def _replace_closed_streams() -> None:
    """Python sets a standard stream that the caller has closed to None; writing to it must not fail."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


def _discard_output() -> None:
    """Standard output cannot be written. Without this, the interpreter would report the buffered rest at exit."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, sys.stdout.fileno())
    os.close(null)


__all__ = ["main"]
