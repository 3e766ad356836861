#!/usr/bin/env python3
"""Stands in for `ssh` where no SSH server is needed: the host is this machine, with another home directory.

``STAND_IN_HOME``: that directory. ``STAND_IN_SAYS``: a file with what it writes to standard error and the status it
ends with, instead of a login. ``STAND_IN_CALLS``: the file to which its arguments are appended. A forwarded socket is
a symbolic link, so what is forwarded to is the other end itself.
"""

import json
import os
import sys
from pathlib import Path


def main(words: list[str]) -> int:
    if calls := os.environ.get("STAND_IN_CALLS"):
        with open(calls, "a") as file:
            file.write(json.dumps(words) + "\n")
    if "-O" in words:
        local, _, remote = words[words.index("-L") + 1].partition(":")
        if (said := refusal("forward")) is not None:
            return said
        Path(local).unlink(missing_ok=True)
        os.symlink(remote, local)
        return 0
    if (said := refusal("login")) is not None:
        return said
    home = os.environ["STAND_IN_HOME"]
    environment = {name: value for name, value in os.environ.items() if name != "XDG_RUNTIME_DIR"}
    os.chdir(home)
    os.execve("/bin/sh", ["sh", "-c", words[-1]], {**environment, "HOME": home})


def refusal(step: str) -> "int | None":
    path = Path(os.environ.get("STAND_IN_SAYS", "/nonexistent"))
    if not path.exists():
        return None
    answer = json.loads(path.read_text())
    if answer["step"] != step:
        return None
    sys.stderr.write(answer["text"])
    return int(answer["status"])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
