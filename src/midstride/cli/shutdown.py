"""``down``: through the manager where one is running, else directly, from the state that a killed manager left."""

from __future__ import annotations

import time
from contextlib import suppress

import click

from midstride import backends
from midstride.cli.client import Client
from midstride.cli.follow import Sending, Sent, explained_when_interrupted
from midstride.cli.platforms import make_backend
from midstride.cli.running_systems import find
from midstride.errors import (
    BackendError,
    EndUnknown,
    ManagerBusy,
    ManagerError,
    MidstrideError,
    NoManager,
    OtherVersion,
)
from midstride.model.component import DEFAULT_STOP
from midstride.runtime.backend_protocol import Backend
from midstride.runtime.process.child_process import end_orphans
from midstride.runtime.process.launcher import killed_in_words, stop_times
from midstride.runtime.records.reports import DownReport, KilledProcess
from midstride.runtime.records.state_store import SavedState, StateStore
from midstride.runtime.records.status_forms import ChangeLock, Status
from midstride.runtime.workspace import Workspace

# How long a manager may take to exit once its system is down (s).
MANAGER_EXIT_TIMEOUT = 10.0
POLL = 0.02


def shut_down(system: str | None) -> tuple[str, DownReport]:
    """Stop a system; its name, and what had to be killed.

    Raises NoManager if none is running, ManagerError if parts remain.
    """
    try:
        client, workspace = find(system)
    except NoManager:
        left = [workspace for workspace in Workspace.all() if system in (None, workspace.name)]
        if len(left) != 1:
            raise
        name = left[0].name
        goes_on = f"Parts of {name} may still run: `midstride down --system {name}` stops what is left."
        with left[0].lock(), explained_when_interrupted(lambda: goes_on):
            return name, DownReport(killed=_stop_left_components(left[0]))
    return workspace.name, stop(client, workspace)


def stop(client: Client, workspace: Workspace) -> DownReport:
    """Have the manager stop its system, and wait until it has ended; where that is interrupted, say what goes on."""
    sending = Sending()
    with explained_when_interrupted(lambda: _interrupted(sending, client, workspace)):
        report = DownReport(killed=[])
        with suppress(OtherVersion):  # it can be told to stop, whatever it says of itself
            _say_what_is_broken_off(client.status(), workspace)
        with suppress(OtherVersion):
            report = client.down(sending.id, sending.begin)
        wait_for_manager_exit(workspace)
    return report


def _say_what_is_broken_off(status: Status, workspace: Workspace) -> None:
    _say_lock(status.lock)
    if (running := status.running) is not None:
        what = "ends first" if running.command == "down" else "is broken off and rolled back first"
        click.echo(f"{workspace.name} is carrying out `{running.command}`, which {what} …", err=True)


def _interrupted(sending: Sending, client: Client, workspace: Workspace) -> str:
    """Keep the manager from being asked, and say what becomes of its system, as far as that is known."""
    name, (fate, waits) = workspace.name, sending.fate(client)
    if fate is not Sent.WITHDRAWN and workspace.manager() is None:
        return f"The manager of {name} has ended: `midstride down --system {name}` stops what is left, if anything is."
    return {
        Sent.WITHDRAWN: "Nothing was stopped: the manager had not been asked yet.",
        Sent.NOT_KNOWN: f"Whether the manager stops {name} is not known: `midstride status` shows what runs.",
        Sent.WAITING: f"The manager stops {name} later: {waits}. `midstride status` shows what runs.",
        Sent.BEGUN: f"The manager is still stopping {name}: `midstride status` shows what still runs.",
        Sent.ENDED: f"{name} could not be stopped whole: `midstride log` says what is left.",
    }[fate]


def _say_lock(lock: ChangeLock | None) -> None:
    if lock is not None:
        click.echo(f"{lock.words}. `down` stops it all the same, and the lock ends with it.", err=True)


def wait_for_manager_exit(workspace: Workspace) -> None:
    """Wait until the next `up` can take the workspace. Raises ManagerError if the manager does not exit."""
    end = time.monotonic() + MANAGER_EXIT_TIMEOUT
    while time.monotonic() < end:
        try:
            with workspace.lock():
                return
        except ManagerBusy:
            time.sleep(POLL)
    raise ManagerError(f"{workspace.name} is down, but its manager has not exited within {MANAGER_EXIT_TIMEOUT:g} s")


def _stop_left_components(workspace: Workspace) -> list[KilledProcess]:
    store = StateStore(workspace.state)
    saved = store.load()
    if saved is None:  # its manager was killed before it could start anything
        store.delete()
        return []
    _say_lock(saved.lock)
    backend = make_backend(saved.backend, workspace)
    killed, failures = backends.run(saved.backend, _stop(backend, saved))
    if failures:
        raise ManagerError("; ".join(failures))
    store.delete()
    return killed


async def _stop(backend: Backend, saved: SavedState) -> tuple[list[KilledProcess], list[str]]:
    """Return what had to be killed, and what failed."""
    await backend.open(lambda _: None)
    killed: list[KilledProcess] = []
    failures: list[str] = []
    handles = [(entry.handle, entry.instance.started) for entry in saved.instances if entry.handle is not None]
    try:
        used = {handle.host for handle, _ in handles}
        hosts = {name: host for name, host in saved.specification.hosts.items() if name in used}
        await backend.reach_hosts(hosts, saved.token, lambda _: None, lambda: False)
        for handle, component in handles:
            name = handle.instance
            try:
                try:
                    runs = await backend.adopt(handle)
                except BackendError:  # it runs, but cannot be controlled: ending it needs no more than its process
                    runs = True
                for process in await backend.end(name, stop_times(component)) if runs else ():
                    words = killed_in_words(name, handle.pid, process)
                    killed.append(KilledProcess(instance=name, seconds=process.seconds, words=words))
            except EndUnknown as error:
                again = f"once host {handle.host} is reached again, run `midstride down` again"
                failures.append(f"{name}: {error}; {again}" if handle.host else f"{name}: {error}")
            except MidstrideError as error:
                failures.append(f"{name}: {error}")
        known = {handle.instance for handle, _ in handles}
        try:
            await end_orphans(saved.token, known, DEFAULT_STOP)
            if hosts:
                await backend.end_orphans(saved.token, known, DEFAULT_STOP)
        except BackendError as error:
            failures.append(str(error))
    finally:
        await backend.close()
    return killed, failures
