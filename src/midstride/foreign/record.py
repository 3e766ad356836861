"""The state of a node without an agent inside it: a file beside the page, so that the next manager can go on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import msgspec

from midstride.codec.component_form import NamedComponentForm
from midstride.errors import BackendError
from midstride.foreign.gate_file import write_gate_file
from midstride.model.instance_names import dotted_name
from midstride.wire.state import GateState, WireValue

_SUFFIX: Final = ".json"


class ForeignRecord(WireValue, frozen=True, kw_only=True):
    """One instance. ``index``: of its node in the page, None where it has no gate.

    ``topics``: by port, the full name that its process uses, after remapping. ``links``: by port, the gate of its
    attachment, of those that are attached. ``outputs``: those that the specification attaches. ``modes``: by
    functionality; ``fallen``: why the reflex has entered these, where it has. ``stated``: the parameters of the
    specification; ``taken_over``: those that were set while its predecessor ran; ``started_with``: all that it had at
    first, once known, except what is only taken over; ``requested``: those that Midstride was asked to set.
    ``predecessor``: the full name of the node that it replaces, where that runs until this one is up; ``replaces``: the
    instance that has it.
    ``was_active``: it is a lifecycle node that another program manages, and it or its predecessor has been active.
    ``draining_since``: since when its goals have been waited for, as its successor takes new ones (monotonic s).
    ``role``: what it is an instance of. ``unnamed``: its program gives the node its name itself, and it was not passed
    one; ``node`` is empty until it is found. ``container``: the full name of the node that has loaded it, if any.
    ``importing``: the process whose state it was asked to import; ``imported``: that whose state it has imported.
    ``process``: the name of the container's process that it shares with others, if any, and ``process_index`` its part
    in the page. ``loaded``: the container has said that it has the node, or none has to load it.
    ``revision`` counts its changes.
    """

    instance: str
    node: str
    token: str
    uuid: str
    pid: int
    started: int
    declaration: NamedComponentForm
    index: int | None
    topics: dict[str, str]
    modes: dict[str, str]
    fallen: dict[str, str] = {}
    links: dict[str, GateState] = {}
    outputs: list[str] = []
    stated: dict[str, Any] = {}
    taken_over: dict[str, Any] = {}
    started_with: dict[str, Any] | None = None
    requested: list[str] = []
    welcomed: bool = False
    predecessor: str | None = None
    replaces: str = ""
    was_active: bool = False
    draining_since: float | None = None
    role: str = ""
    unnamed: bool = False
    container: str = ""
    importing: str = ""
    imported: str = ""
    process: str = ""
    process_index: int | None = None
    loaded: bool = True
    revision: int = 0

    @property
    def simulated_time(self) -> bool:
        """Return whether contracts are meant on `/clock`, of which the page of the gates has no times."""
        return bool(self.stated.get("use_sim_time"))

    def write(self, folder: Path) -> None:
        """Replace the file of this instance. Raises BackendError."""
        write_gate_file(_path(folder, self.instance), msgspec.json.encode(self))

    @classmethod
    def read(cls, folder: Path, instance: str) -> ForeignRecord | None:
        """Read the record of ``instance``; None where there is none. Raises BackendError."""
        path = _path(folder, instance)
        try:
            return msgspec.json.decode(path.read_bytes(), type=cls)
        except FileNotFoundError:
            return None
        except (OSError, msgspec.DecodeError) as error:
            raise BackendError(f"{path} cannot be read: {error}") from None

    @classmethod
    def all(cls, folder: Path) -> Iterator[ForeignRecord]:
        """Yield all records that can be read."""
        for path in sorted(folder.glob(f"*{_SUFFIX}")):
            with suppress(OSError, msgspec.DecodeError):
                yield msgspec.json.decode(path.read_bytes(), type=cls)

    def delete(self, folder: Path) -> None:
        _path(folder, self.instance).unlink(missing_ok=True)


def _path(folder: Path, instance: str) -> Path:
    return folder / f"{dotted_name(instance)}{_SUFFIX}"
