"""The completion scripts that the ROS package installs, and its set-up file sources: Click's, for each shell."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import click
from click.shell_completion import get_completion_class

from midstride.cli.shell_completion import VARIABLE

FOLDER: Final = Path(__file__).resolve().parent.parent / "ros" / "completion"
# A shell that has not loaded its completion yet has no `compdef`.
_ZSH: Final = "(( $+functions[compdef] )) || { autoload -Uz compinit && compinit }\n"


def script(shell: str) -> str:
    """The script of `bash`, `zsh` or `fish`."""
    kind = get_completion_class(shell)
    assert kind is not None, shell
    made = kind(click.Command("midstride"), {}, "midstride", VARIABLE)
    text = made.source_template % made.source_vars()
    lines = "\n".join(line.rstrip() for line in text.strip().splitlines()) + "\n"
    if shell != "zsh":
        return lines
    head, _, rest = lines.partition("\n")
    assert head.startswith("#compdef")
    return f"{head}\n{_ZSH}{rest}"
