"""The computers that a system runs on (docs/semantics.md section 2).

The host of the manager has no declaration and the name ``""``; a specification writes ``manager`` where it has to name
it. A resource belongs to one host: two of one name on two hosts are two resources, whose keys :func:`resource_key`
makes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

# The host of the manager, as a name in the model, and the word for it in specifications, commands and messages.
OWN_HOST: Final = ""
MANAGER: Final = "manager"


@dataclass(frozen=True, slots=True)
class HostSpec:
    """A computer that the manager reaches by OpenSSH.

    ``ssh``: the destination as `ssh` takes it, such as ``robot@arm``; a name in the user's own configuration of OpenSSH
    will do. ``setup``: the file there that a shell sources before anything is started, None for none. ``folder``: where
    programs run there, and below which Midstride keeps its workspace; None for the home directory of the user there.
    Both are absolute paths on the host.
    """

    name: str
    ssh: str
    setup: str | None = None
    folder: str | None = None


def host_in_words(host: str) -> str:
    """The host as messages name it: ``host arm``, or ``the host of the manager``."""
    return f"host {host}" if host else "the host of the manager"


def host_of_word(word: str) -> str:
    """The name in the model of a host that a specification or a command names."""
    return OWN_HOST if word == MANAGER else word


def word_of_host(host: str) -> str:
    """The word by which specifications and commands name a host."""
    return host or MANAGER


def resource_key(resource: str, host: str) -> str:
    """The name by which configurations hold a resource: ``gpu``, and ``gpu on arm`` where another host has it."""
    return f"{resource} on {host}" if host else resource
