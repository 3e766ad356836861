"""The program `ros2`: its commands are the entry points of the group `ros2cli.command`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from .command import add_subparsers_on_demand


def main(*, script_name: str = "ros2", argv: Sequence[str] | None = None) -> object:
    parser = argparse.ArgumentParser(prog=script_name, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_subparsers_on_demand(parser, script_name, "_command", "ros2cli.command", required=False, argv=argv)
    try:
        from argcomplete import autocomplete
    except ImportError:
        pass
    else:
        autocomplete(parser, exclude=["-h", "--help"])
    args = parser.parse_args(argv)
    if not hasattr(args, "_command"):
        parser.print_help()
        return 0
    return args._command.main(parser=parser, args=args)
