"""What verbs of commands derive from."""

from __future__ import annotations


class VerbExtension:
    """A verb: NAME is that of its entry point, and `main(*, args)` carries it out."""

    NAME: str | None = None
