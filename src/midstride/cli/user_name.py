"""The name of the user who runs this command, for the history and for locks."""

from __future__ import annotations

import getpass
import os


def user_name() -> str:
    """The name of the user."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user without a name
        return f"user {os.getuid()}"
