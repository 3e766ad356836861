"""``lsp``: the language server on standard input and output; an editor starts it."""

from __future__ import annotations

import os
import sys

import click

from midstride.cli.output import json_option
from midstride.errors import MidstrideError


@click.command("lsp")
@click.option("--stdio", is_flag=True, help="Accepted because editors pass it; it is the only transport.")
@json_option
def lsp_command(stdio: bool) -> int:
    """Run the language server on standard input and output. Editors start it.

    Needs the extra `midstride[lsp]`.
    """
    try:
        from midstride.cli.language_server import make_server
    except ImportError as error:
        raise MidstrideError(f"the language server needs pygls ({error}); install `midstride[lsp]`") from None
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as output:  # the server closes its output at the end
        make_server().start_io(stdout=output)
    return 0
