"""The database from which the next manager recovers a running system, in the system's workspace.

A manager may be killed at any moment, so each process is recorded as soon as it is started: one without a record would
run forever and keep its name in use. Each write is one row and durable when the call returns; its cost does not depend
on the size of the system.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, TypeAlias

import msgspec
from immutables import Map

from midstride.codec.component_form import ComponentForm
from midstride.codec.configuration_form import InstanceForm
from midstride.codec.parameter import from_json, json_values
from midstride.codec.specification_form import (
    CONNECTOR_FORMS,
    NodeForm,
    SpecificationForm,
    decode_saved_specification,
    of_kind,
)
from midstride.codec.writing import to_json
from midstride.errors import ManagerError, MidstrideError, Superseded
from midstride.model.configuration import Instance
from midstride.model.specification import Specification
from midstride.runtime.backend_protocol import Handle
from midstride.runtime.options import NO_OPTIONS, SystemOptions
from midstride.runtime.records.disk import DISK, Database, Disk, Lease, Statement, refused
from midstride.runtime.records.status_forms import ChangeLock
from midstride.wire.folders import COMPONENTS

# The form of the database; a manager of another version refuses it.
VERSION: Final = 3
_SCHEMA: Final = """
CREATE TABLE IF NOT EXISTS system (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS specification (
    section TEXT, name TEXT, form TEXT NOT NULL, PRIMARY KEY (section, name)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS instances (name TEXT PRIMARY KEY, form TEXT NOT NULL, handle TEXT) WITHOUT ROWID;
"""
# The section of the specification with all that is in none of the other three.
_REST: Final = "rest"
# Before the name of a role, for its parameter values that were set at run time.
_VALUES: Final = "values of "
# The parameter values of instances that a change under way has carried over.
_CARRIED: Final = "carried"
# Before the name of a role, for the state that its last instance has exported.
_EXPORTED: Final = "exported of "
# The roles without an instance whose last one had left its container.
_APART: Final = "apart"
# The instances that count as exited on a host that cannot be reached.
_SILENT: Final = "silent"
_LOCK: Final = "lock"
# Instead of the handle of an instance whose program has ended as it should.
_DONE: Final = "done"
# Statements by what they write.
_Statements: TypeAlias = dict[str, Statement]


@dataclass(frozen=True, slots=True)
class SavedInstance:
    """An instance that an earlier manager knew. ``handle`` is None if it was started elsewhere, or is ``done``."""

    instance: Instance
    handle: Handle | None
    done: bool = False


class LeftState(msgspec.Struct, frozen=True):
    """The ``state`` that an instance has exported before it was removed; ``exporter`` is the UUID of its process."""

    exporter: str
    state: bytes


@dataclass(frozen=True, slots=True)
class SavedState:
    """The state that an earlier manager saved.

    ``values``: by role, the parameter values that were set at run time. ``carried``: by instance, those when a change
    that has not ended last carried them over. ``exported``: by role, the state of an instance that such a change has
    removed before its successor was there. ``apart``: by role that has none, the container that its last instance had
    left. ``silent``: the instances that counted as exited on a host that cannot be reached. ``file`` was brought up or
    applied last, if any, and ``changed_since``: another command has changed the specification then. ``lock``: a person
    has locked it. ``reach``: as of :meth:`midstride.runtime.backend_protocol.Backend.reach`.
    """

    backend: str
    token: str
    specification: Specification
    instances: tuple[SavedInstance, ...]
    options: SystemOptions = NO_OPTIONS
    values: dict[str, dict[str, Any]] = field(default_factory=dict)
    file: str | None = None
    changed_since: bool = False
    lock: ChangeLock | None = None
    reach: dict[str, str] = field(default_factory=dict)
    carried: dict[str, dict[str, Any]] = field(default_factory=dict)
    exported: dict[str, LeftState] = field(default_factory=dict)
    apart: dict[str, str] = field(default_factory=dict)
    silent: frozenset[str] = frozenset()


class StateStore:
    """The state of one system in the file ``path``. ``warn`` is called once when the disk starts to refuse writes.

    A failed write does not interrupt a change: ``unwritten`` says why it failed until a later write succeeds.
    """

    def __init__(self, path: Path, warn: Callable[[str], object] = lambda _: None, disk: Disk = DISK) -> None:
        self.path = path
        self.unwritten: str | None = None
        self._warn = warn
        self._disk = disk
        self._database: Database | None = None
        self._specification = Specification("")  # as last written
        self._carried: dict[str, dict[str, Any]] = {}  # as last written
        self._apart: dict[str, str] = {}  # as last written
        self._silent: frozenset[str] = frozenset()  # as last written
        self._pending: _Statements = {}  # writes that failed
        self._lease = Lease("system")

    @property
    def superseded(self) -> bool:
        """Another manager of the system has taken the lease."""
        return self._lease.superseded(self._database)

    # -- reading -----------------------------------------------------------------------------------

    def load(self) -> SavedState | None:
        """The state that an earlier manager saved, or None. Raises ManagerError if it cannot be read."""
        try:
            database = self._disk.read_only(self.path)
            if database is None:
                return None
            with closing(database):
                system = dict(database.read("SELECT key, CAST(value AS TEXT) FROM system"))
                if not system and database.read("PRAGMA user_version") == [(0,)]:
                    return None  # killed before `begin`: no component had the token
                if (version := system.get("version", "")) != str(VERSION):
                    raise self._of_another_version(version)
                parts = database.read("SELECT section, name, form FROM specification")
                rows = database.read("SELECT form, handle FROM instances ORDER BY name")
            carried = msgspec.json.decode(system.get(_CARRIED, "{}"), type=dict[str, dict[str, Any]])
            self._carried = {name: _values(forms) for name, forms in carried.items()}
            self._apart = msgspec.json.decode(system.get(_APART, "{}"), type=dict[str, str])
            self._silent = msgspec.json.decode(system.get(_SILENT, "[]"), type=frozenset[str])
            return SavedState(
                system["backend"],
                system["token"],
                _specification(tuple(parts)),
                tuple(_instance(form, handle) for form, handle in rows),
                msgspec.json.decode(system.get("options", "{}"), type=SystemOptions),
                {
                    key.removeprefix(_VALUES): _values(msgspec.json.decode(value, type=dict[str, Any]))
                    for key, value in system.items()
                    if key.startswith(_VALUES)
                },
                system.get("file") or None,
                bool(system.get("changed_since")),
                None if (lock := system.get(_LOCK)) is None else msgspec.json.decode(lock, type=ChangeLock),
                msgspec.json.decode(system.get("reach", "{}"), type=dict[str, str]),
                {**self._carried},
                {
                    key.removeprefix(_EXPORTED): msgspec.json.decode(value, type=LeftState)
                    for key, value in system.items()
                    if key.startswith(_EXPORTED)
                },
                dict(self._apart),
                self._silent,
            )
        except ManagerError:
            raise
        except KeyError as error:
            raise self._unreadable(f"it is damaged: it has no {error}") from error
        except RecursionError as error:
            raise self._unreadable("it is damaged: it is nested too deep") from error
        except (sqlite3.Error, OSError, msgspec.DecodeError, MidstrideError, ValueError, TypeError) as error:
            if refused(error):
                raise ManagerError(
                    f"cannot read {self.path} now: {error}. The components that were started keep running; make room "
                    "if its disk is full, then try again"
                ) from error
            raise self._unreadable(f"it is damaged: {error}") from error

    def _of_another_version(self, version: str) -> ManagerError:
        if not version.isdecimal():
            return self._unreadable("it is damaged: it has no version")
        which = "a newer" if int(version) > VERSION else "an earlier"
        return ManagerError(
            f"cannot read {self.path}: {which} version of Midstride wrote it, in form {version}, and this one reads "
            f"{VERSION}. The components that were started keep running: use that version to manage them, or stop them "
            "by its `midstride down` before `up` of this one"
        )

    def _unreadable(self, why: str) -> ManagerError:
        folder = self.path.parent
        return ManagerError(
            f"cannot read {self.path}: {why}. No manager can take over the components that were started, and they keep "
            f"running. So it is unknown which components of {folder.name} still run: stop them yourself (their control "
            f"sockets are in {folder / COMPONENTS}), then remove the file"
        )

    # -- writing -----------------------------------------------------------------------------------

    def begin(
        self,
        backend: str,
        token: str,
        specification: Specification,
        options: SystemOptions = NO_OPTIONS,
        file: str | None = None,
        changed_since: bool = False,
        reach: Mapping[str, str] = Map(),
    ) -> None:
        """The system is being brought up or recovered."""
        kept, joined = (msgspec.json.encode(each).decode() for each in (options, dict(reach)))
        system = ("version", str(VERSION), "backend", backend, "token", token, "options", kept, "reach", joined)
        self._specification = Specification("")
        # At once: half of this could not be read.
        statements: _Statements = {
            **_puts(*system),
            **_origin(file, changed_since),
            "specification": ("DELETE FROM specification", ()),
        }
        self._write({**statements, **self._parts(specification), "begun": (f"PRAGMA user_version = {VERSION}", ())})

    def take_over(self) -> None:
        """Take the lease: what an earlier manager writes from now on is not kept."""
        self._write({})

    def write_specification(self, specification: Specification) -> None:
        """The specification that the system runs now: a row for each part that differs from what was written last.

        It is that of no file, until :meth:`write_file`.
        """
        parts = self._parts(specification)
        self._write({**parts, **_puts("changed_since", "yes")} if parts else {})

    def _parts(self, specification: Specification) -> _Statements:
        """The statements that replace the specification that was written last by this one."""
        before, self._specification = self._specification, specification
        sections: list[tuple[str, Mapping[str, Any], Mapping[str, Any], Callable[[Any], object]]] = [
            *(
                (
                    f"{kind}s",
                    of_kind(before.connectors, kind),
                    of_kind(specification.connectors, kind),
                    form.of_connector,
                )
                for kind, form in CONNECTOR_FORMS.items()
                if before.connectors is not specification.connectors
            ),
            ("components", before.components, specification.components, ComponentForm.of),
            ("nodes", before.nodes, specification.nodes, lambda node: NodeForm.of(node, specification)),
            (_REST, {"": _rest(before)}, {"": _rest(specification)}, SpecificationForm.of),
        ]
        statements: _Statements = {}
        for section, old, new, form in sections:
            for name in _changed(old, new):
                if name in new:
                    row = (section, name, msgspec.json.encode(form(new[name])).decode())
                    statements[f"{section} {name}"] = ("INSERT OR REPLACE INTO specification VALUES (?, ?, ?)", row)
                else:
                    delete = "DELETE FROM specification WHERE section = ? AND name = ?"
                    statements[f"{section} {name}"] = (delete, (section, name))
        return statements

    def write_file(self, file: str) -> None:
        """The file that the specification was read from."""
        self._write(_origin(file))

    def write_instance(self, instance: Instance, handle: Handle | None, *, done: bool = False) -> None:
        """An instance has been started, its parameters have changed, or it is ``done``: its program was to end."""
        form = msgspec.json.encode(InstanceForm.of(instance)).decode()
        kept = _DONE if done else None if handle is None else to_json(handle).decode()
        row = ("INSERT OR REPLACE INTO instances VALUES (?, ?, ?)", (instance.name, form, kept))
        self._write({f"instance {instance.name}": row})

    def remove_instance(self, name: str) -> None:
        """An instance has exited or was released."""
        self._write({f"instance {name}": ("DELETE FROM instances WHERE name = ?", (name,))})

    def write_values(self, role: str, values: Mapping[str, Any]) -> None:
        """The values of a role's parameters that were set at run time."""
        key = f"{_VALUES}{role}"
        if values:
            self._write(_puts(key, msgspec.json.encode(json_values(values)).decode()))
        else:
            self._write({key: ("DELETE FROM system WHERE key = ?", (key,))})

    def write_carried(self, carried: Mapping[str, Mapping[str, Any]]) -> None:
        """The values that the change under way has carried over, by instance; none: there is no such change."""
        found = {name: dict(values) for name, values in carried.items() if values}
        if found != self._carried:
            self._carried = found
            forms = {name: json_values(values) for name, values in found.items()}
            self._write(_puts(_CARRIED, msgspec.json.encode(forms).decode()))

    def write_exported(self, role: str, state: LeftState | None) -> None:
        """The state that the last instance of a role has exported, until its successor has imported it; then None."""
        key = f"{_EXPORTED}{role}"
        if state is not None:
            self._write(_puts(key, msgspec.json.encode(state).decode()))
        else:
            self._write({key: ("DELETE FROM system WHERE key = ?", (key,))})

    def write_apart(self, apart: Mapping[str, str]) -> None:
        """By role without an instance, the container that its last one had left for a process for itself."""
        if apart != self._apart:
            self._apart = dict(apart)
            self._write(_puts(_APART, msgspec.json.encode(self._apart).decode()))

    def write_silent(self, names: Collection[str]) -> None:
        """The instances that count as exited on a host that cannot be reached: the next manager ends them later."""
        if frozenset(names) != self._silent:
            self._silent = frozenset(names)
            self._write(_puts(_SILENT, msgspec.json.encode(sorted(names)).decode()))

    def write_lock(self, lock: ChangeLock | None) -> None:
        """A person has locked the system, or None: the lock has ended."""
        if lock is not None:
            self._write(_puts(_LOCK, msgspec.json.encode(lock).decode()))
        else:
            self._write({_LOCK: ("DELETE FROM system WHERE key = ?", (_LOCK,))})

    def require(self) -> None:
        """Raises ManagerError if the state cannot be written."""
        self._write(_puts("checked", ""))
        if self.unwritten is not None:
            raise ManagerError(self.unwritten)

    def delete(self) -> None:
        """Delete the database: the system is down, or was never up."""
        self.close()
        self._disk.remove(self.path)
        self._lease.renew()
        self._carried, self._apart, self._silent = {}, {}, frozenset()

    def close(self) -> None:
        database, self._database = self._database, None
        if database is not None:
            database.close()

    def _write(self, statements: _Statements) -> None:
        for key in statements:  # each in the order in which they were asked for last: one of them empties a table
            self._pending.pop(key, None)
        self._pending.update(statements)
        try:
            self._lease.write(self._open(), self._pending.values())
        except Superseded as error:
            self.unwritten = str(error)
            self._pending.clear()
            return
        except (sqlite3.Error, OSError) as error:
            why = f"cannot write {self.path}: {error}"
            if self.unwritten is None:
                self._warn(f"{why}; a later manager would not find everything again")
            self.unwritten = why
            return
        self._pending.clear()
        self.unwritten = None

    def _open(self) -> Database:
        if self._database is None:
            self._database = self._disk.open(self.path, _SCHEMA)  # for its user alone: it holds the system's token
        return self._database


def _values(forms: Mapping[str, Any]) -> dict[str, Any]:
    return {name: from_json(form) for name, form in forms.items()}


def _puts(*pairs: str) -> _Statements:
    rows = zip(pairs[::2], pairs[1::2], strict=True)
    return {key: ("INSERT OR REPLACE INTO system VALUES (?, ?)", (key, value)) for key, value in rows}


def _origin(file: str | None, changed_since: bool = False) -> _Statements:
    return _puts("file", file or "", "changed_since", "yes" if changed_since else "")


def _changed(before: Mapping[str, object], after: Mapping[str, object]) -> Iterator[str]:
    """The names of what was added, removed or replaced."""
    if before is after:
        return
    yield from (name for name in before if name not in after)
    yield from (name for name, value in after.items() if (old := before.get(name)) is not value and old != value)


def _rest(specification: Specification) -> Specification:
    return replace(specification, connectors=Map(), components=Map(), nodes=Map())


@lru_cache(maxsize=4)
def _specification(parts: tuple[tuple[str, str, str], ...]) -> Specification:
    rest: dict[str, Any] = {}
    sections: dict[str, dict[str, Any]] = {}
    for section, name, form in parts:
        if section == _REST:
            rest = msgspec.json.decode(form, type=dict[str, Any])
        else:
            sections.setdefault(section, {})[name] = msgspec.json.decode(form)
    return decode_saved_specification({**rest, **sections})


def _instance(form: str, handle: str | None) -> SavedInstance:
    return SavedInstance(
        msgspec.json.decode(form, type=InstanceForm).instance(),
        None if handle is None or handle == _DONE else msgspec.json.decode(handle, type=Handle),
        handle == _DONE,
    )
