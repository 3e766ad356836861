"""``down``: through the manager where there is one, else directly, by what a killed one left written."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import click

from midstride import backends
from midstride.cli.systems import find
from midstride.errors import BackendError, ManagerBusy, ManagerError, MidstrideError, NoManager
from midstride.runtime.backend import Backend, Handle
from midstride.runtime.launcher import STOP_GRACE
from midstride.runtime.orphans import end_orphans
from midstride.runtime.state_store import StateStore
from midstride.runtime.workspace import Workspace

# How long a manager may take to end once its system is down (s).
LAST_BREATH = 10.0
POLL = 0.02


def take_down(system: str | None) -> str:
    """End a system; its name. Raises NoManager where none is running, ManagerError where something would not end."""
    try:
        client, workspace = find(system)
    except NoManager:
        left = [workspace for workspace in Workspace.all() if system in (None, workspace.name)]
        if len(left) != 1:
            raise
        with left[0].lock():
            _end_what_is_left(left[0])
        return left[0].name
    if (running := client.get("/status")["running"]) is not None:
        click.echo(f"{workspace.name} is carrying out `{running['command']}`: it goes down after that …", err=True)
    client.post("/down")
    until_free(workspace)
    return workspace.name


def until_free(workspace: Workspace) -> None:
    """The system is down; its manager is about to end. Then the next `up` finds nobody in its way.

    Raises ManagerError where it does not end.
    """
    end = time.monotonic() + LAST_BREATH
    while time.monotonic() < end:
        try:
            with workspace.lock():
                return
        except ManagerBusy:
            time.sleep(POLL)
    raise ManagerError(f"{workspace.name} is down, but its manager has not ended within {LAST_BREATH:g} s")


def _end_what_is_left(workspace: Workspace) -> None:
    store = StateStore(workspace.state)
    saved = store.load()
    if saved is None:
        return
    handles = [entry.handle for entry in saved.instances if entry.handle is not None]
    backend = backends.make(saved.backend, workspace)
    if faults := asyncio.run(_end(backend, handles, saved.token)):
        raise ManagerError("; ".join(faults))
    store.forget()


async def _end(backend: Backend, handles: list[Handle], token: str) -> list[str]:
    def ignore(_: Any) -> None: ...

    await backend.open(ignore)
    faults = []
    try:
        for handle in handles:
            try:
                if await backend.adopt(handle):
                    await backend.end(handle.instance, STOP_GRACE)
            except MidstrideError as error:
                faults.append(f"{handle.instance}: {error}")
        try:
            await end_orphans(token, {handle.instance for handle in handles}, STOP_GRACE)
        except BackendError as error:
            faults.append(str(error))
    finally:
        await backend.close()
    return faults
