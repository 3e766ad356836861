"""The files of the programs of components, and which of them have changed on disk since they started.

Each component lists its files itself, since it alone knows what it has imported; so the next manager can ask again.
The files that ``run`` names are added here, and of a program without Midstride's API what these lead to
(:mod:`.followed_programs`): a component does not know of the script that has started it.
"""

from __future__ import annotations

import asyncio
import itertools
import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Protocol

from midstride.errors import BackendError
from midstride.model.component import ComponentSpec
from midstride.model.configuration import Configuration, Instance
from midstride.runtime.process.component_client import ComponentClient, ComponentEvent, Disconnected
from midstride.runtime.records.status_forms import ProgramStatus
from midstride.runtime.view.followed_programs import followed, followed_module, module_folders
from midstride.wire.commands import ProgramCommand
from midstride.wire.program import FileFingerprint, Program, files_named

# How long to wait for the answers of components that are being asked (s).
PATIENCE: Final = 1.0


class FindExecutable(Protocol):
    """Finds an executable, as :meth:`midstride.runtime.backend_protocol.Backend.executable`."""

    def __call__(self, package: str, name: str, *, composable: bool = False) -> str | None: ...


def _find_none(package: str, name: str, *, composable: bool = False) -> str | None:
    return None


@dataclass
class _Known:
    """The files of the process ``uuid``, as it named them when it had ``imported`` so many modules; ``named``: the
    files of `run`.

    ``latest`` has the files that were compared, each with its time of modification then.
    """

    uuid: str
    imported: int
    program: Program | None = None
    named: list[FileFingerprint] | None = None
    latest: dict[str, FileFingerprint] = field(default_factory=dict)

    def changed(self, files: list[FileFingerprint]) -> list[str]:
        """The ``files`` that have changed. One that was touched is read again once, not at each call."""
        now = {file.path: self.latest.get(file.path, file).unchanged() for file in files}
        self.latest |= {path: file for path, file in now.items() if file is not None}
        return [path for path, file in now.items() if file is None]


@dataclass
class Programs:
    """Asks each component for its files when it appears, and again when it has imported more modules.

    ``directory`` is that of the system's processes; ``executable``: the file of an executable of a package.
    """

    client: ComponentClient
    directory: Path
    executable: FindExecutable = _find_none
    _known: dict[str, _Known] = field(default_factory=dict)
    _asking: dict[str, asyncio.Task[None]] = field(default_factory=dict)

    def on_component_event(self, state: ComponentEvent) -> None:
        """A component has reported its state, or it has disconnected."""
        if isinstance(state, Disconnected):
            return
        known = self._known.get(state.instance)
        if known is None or known.uuid != state.uuid:
            known = self._known[state.instance] = _Known(state.uuid, 0)
        if known.imported != state.imported:
            known.imported = state.imported
            self._asking[state.instance] = asyncio.get_running_loop().create_task(self._ask(state.instance, known))

    async def _ask(self, instance: str, known: _Known) -> None:
        try:
            known.program = await self.client.read(instance, ProgramCommand())
        except BackendError:
            known.imported = 0  # its next report makes this ask again

    async def await_answers(self) -> None:
        """Wait until the components that are being asked have answered, or have had the time for it."""
        if pending := [asking for asking in self._asking.values() if not asking.done()]:
            await asyncio.wait(pending, timeout=PATIENCE)

    async def status(self, configuration: Configuration) -> list[ProgramStatus]:
        """The status of the program of each instance, by name."""
        running = configuration.instances
        for gone in [name for name, asking in self._asking.items() if name not in running and asking.done()]:
            del self._asking[gone]
            self._known.pop(gone, None)
        found = [(instance, self._known.get(name)) for name, instance in sorted(running.items())]
        found = [(instance, known) for instance, known in found if not instance.component.once]  # it runs no more
        return await asyncio.to_thread(lambda: [self._of(instance, known) for instance, known in found])

    def _of(self, instance: Instance, known: _Known | None) -> ProgramStatus:
        program = None if known is None else known.program
        files: list[FileFingerprint] = []
        changed: list[str] = []
        if known is not None and program is not None and not instance.host:
            if known.named is None:
                known.named = self._named(instance, program)
            files = [*program.files, *known.named]
            changed = known.changed(files)
        return ProgramStatus(
            name=instance.name,
            role=instance.role,
            files=[file.path for file in files],
            changed=changed,
            unknown=_unknown(instance, program),
            startable=instance.component.run is not None,
            executable=None if instance.host else self._executable(instance.component),
        )

    def _named(self, instance: Instance, program: Program) -> list[FileFingerprint]:
        component, directory = instance.component, str(self.directory)
        words, listed = _words(component), {file.path for file in program.files}
        named = list(files_named(words, directory))
        found = self._executable(component)
        if found is not None:
            named.insert(0, found)
        if component.container is not None:
            named = [] if found is None else [found]
        elif component.gate is not None:  # its process does not say what it has imported
            environment = {**os.environ, **component.environment}
            # PREFIX/lib/PACKAGE/NAME
            prefix = None if found is None else os.path.dirname(os.path.dirname(os.path.dirname(found)))
            folders = module_folders(environment, prefix)
            behind = [each for path in named for each in followed(path, folders)]
            if (module := _module_of(words)) is not None:
                behind += followed_module(module, [directory, *folders])
            named = behind
        paths = dict.fromkeys(path for path in named if path not in listed)
        return [file for path in paths if (file := FileFingerprint.read(path, program.started)) is not None]

    def _executable(self, component: ComponentSpec) -> str | None:
        """The file of the package's executable, or the library of its class, that it names, if it names one."""
        words = _words(component)
        if component.package is None or not words:
            return None
        return self.executable(component.package, words[0], composable=component.container is not None)

    async def close(self) -> None:
        for asking in self._asking.values():
            asking.cancel()
        await asyncio.gather(*self._asking.values(), return_exceptions=True)


def _words(component: ComponentSpec) -> list[str]:
    try:
        return shlex.split(component.run or "")
    except ValueError:
        return []


def _module_of(words: Sequence[str]) -> str | None:
    """The module of `python3 -m MODULE`."""
    for before, after in itertools.pairwise(words):
        if before == "-m" and "python" in os.path.basename(words[0]):
            return after
    return None


def _unknown(instance: Instance, program: Program | None) -> str | None:
    if instance.host:
        return f"it runs on host {instance.host}: the files there are not compared"
    if program is None:
        return "it has not said which files its program has"
    if instance.component.gate is not None:
        return (
            "it does not use Midstride's API: only the files that its `run` command names are compared, and the "
            "modules that these import from beside them or from their own package"
        )
    if not program.complete:
        return f"it has more modules than the {len(program.files)} that are compared"
    if instance.component.run is None:
        return "it was started by hand: the files on its command line are not known"
    return None
