"""Programs into which the library of the gate cannot be loaded, and such as need another library before it.

The loader of Linux loads what ``LD_PRELOAD`` names before the libraries of a program, unless the program is statically
linked, is for another kind of processor, or gets privileges by its start (``AT_SECURE`` in ld.so(8)).
"""

from __future__ import annotations

import os
import re
import shutil
import stat
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from midstride.foreign.elf import ElfFile, read_elf

PRELOAD: Final = "LD_PRELOAD"
# The runtime libraries of sanitizers: AddressSanitizer ends a process in which another library is before its own.
_SANITIZER: Final = re.compile(r"(lib(asan|hwasan|lsan|tsan|ubsan)\.so|libclang_rt\.)")
# What programs that publish by Agnocast are linked with, and what they preload.
_AGNOCAST: Final = "libagnocast"
_CAPABILITIES: Final = "security.capability"
# How many interpreters of scripts are followed, as the kernel does.
_SCRIPTS: Final = 4
_LOADER: Final = re.compile(r"ld(-|\.so)")  # it may be named as a program, too
_AT_SECURE: Final = 23
# A program that also uses rcl has made its endpoints by then (s), besides what it states (`takes`).
AGNOCAST_SETTLED: Final = 5.0
# Starts its arguments as another program, in its own process, after variables and options.
_ENV: Final = "env"


@dataclass(frozen=True, slots=True)
class StartedPrograms:
    """The programs of one command: its first word, and the one behind its prefix; ``libraries`` that it loads later.

    ``environment`` is that of the process.
    """

    programs: tuple[str, ...]
    environment: Mapping[str, str]
    libraries: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, command: Sequence[str], prefix: int, environment: Mapping[str, str], libraries: Sequence[str] = ()
    ) -> StartedPrograms:
        """The programs of ``command``, of which the first ``prefix`` words stand before the program itself."""
        found = list(_run_by(list(command[prefix:]), environment))
        if prefix:
            found = [*_run_by(list(command[:prefix]), environment), *found]
        return cls(tuple(dict.fromkeys(found)), environment, tuple(libraries))

    def why_not(self, library: Path | None = None) -> str | None:
        """Why a gate in the process would hold nothing back, and what to write instead; None where nothing says so.

        ``library``: that of the gate, where it is there already.
        """
        gate = None if library is None else read_elf(library)
        reasons = (why_not_loaded(program, gate) for program in self.programs)
        return next(filter(None, reasons), None) or self._agnocast()

    def _agnocast(self) -> str | None:
        preloaded = next((each for each in _listed(self.environment) if _AGNOCAST in os.path.basename(each)), None)
        if preloaded is not None:
            return _by_agnocast(f"`{PRELOAD}` has {os.path.basename(preloaded)}")
        for path in (*self.programs, *self.libraries):
            found = read_elf(path)
            if found is not None and (name := next((each for each in found.needed if _AGNOCAST in each), None)):
                return _by_agnocast(f"{path} is linked with {name}")
        return None

    def preloaded(self, library: Path) -> str:
        """The value of ``LD_PRELOAD`` with the gate: the runtimes of sanitizers, ``library``, and what was stated.

        The runtime that a program is linked with is added: else its process would end with a message of it.
        """
        stated = _listed(self.environment)
        needed = [name for path in self.programs if (elf := read_elf(path)) for name in elf.needed]
        present = {os.path.basename(each) for each in stated}
        runtimes = [each for each in stated if _SANITIZER.match(os.path.basename(each))]
        runtimes += [each for each in dict.fromkeys(needed) if _SANITIZER.match(each) and each not in present]
        others = [each for each in stated if each not in runtimes]
        return ":".join([*runtimes, str(library), *others])


@dataclass(frozen=True, slots=True)
class Unseen:
    """Why a process has an endpoint that the library does not see.

    ``settled``: how long after its start that is certain (s); None: as long as it runs, it may change.
    """

    why: str
    settled: float | None = 0.0


def why_not_loaded(program: str, gate: ElfFile | None = None) -> str | None:
    """Why the loader does not load the library of the ``gate`` into ``program``, and what to write instead."""
    if (elf := read_elf(program)) is None:
        return None
    if not elf.loader and not _LOADER.match(os.path.basename(program)):
        return f"{program} is statically linked, and no library can be loaded into it: declare it with `gate relay`"
    if gate is not None and not elf.is_for_processor_of(gate):
        return (
            f"{program} is for {elf.processor}, and the library of the gate for {gate.processor}: "
            "declare it with `gate relay`"
        )
    if (why := _privileges(program)) is not None:
        return f"{program} {why}"
    return None


def why_unseen(pid: int) -> Unseen | None:
    """Why the library does not see what the process ``pid``, or one below it, writes; None where nothing shows it."""
    for each in _family(pid):
        with suppress(OSError):
            if (privileged := _has_privileges(each)) is not False:
                got = (
                    "got privileges at its start"
                    if privileged
                    else "may not be looked into, and seems to have privileges"
                )
                return Unseen(
                    f"its process {each} {got}, so the loader has ignored `{PRELOAD}`: declare it with `gate relay` or "
                    "`gate none`",
                    settled=0.0 if privileged else None,
                )
            if _AGNOCAST in Path(f"/proc/{each}/maps").read_text(errors="replace"):
                return Unseen(_by_agnocast(f"its process {each} has loaded it"), settled=AGNOCAST_SETTLED)
            if (why := why_not_loaded(os.readlink(f"/proc/{each}/exe"))) is not None:
                return Unseen(why, settled=None)  # it may start a program that is none
    return None


def _family(pid: int) -> Iterator[int]:
    """The process ``pid`` and those below it."""
    yield pid
    for children in Path(f"/proc/{pid}/task").glob("*/children"):  # of each of its threads
        with suppress(OSError):
            for child in children.read_text().split():
                yield from _family(int(child))


def _has_privileges(pid: int) -> bool | None:
    """Return whether the loader of a process was told to ignore ``LD_PRELOAD``; None where one may not look."""
    try:
        vector = Path(f"/proc/{pid}/auxv").read_bytes()
    except PermissionError:
        return None
    return any(kind == _AT_SECURE and value for kind, value in struct.iter_unpack("NN", vector))


def _by_agnocast(seen: str) -> str:
    return f"what it publishes by Agnocast does not pass the gate ({seen}): declare it with `gate none`"


def _listed(environment: Mapping[str, str]) -> list[str]:
    return [each for each in re.split(r"[:\s]+", environment.get(PRELOAD, "")) if each]


def _run_by(words: list[str], environment: Mapping[str, str]) -> Iterator[str]:
    """The paths of the programs that these words start: the interpreter of a script, and what `env` starts."""
    for _ in range(_SCRIPTS):
        if not words or (path := shutil.which(words[0], path=environment.get("PATH"))) is None:
            return
        if interpreter := _interpreter(path):
            words = [*interpreter, path, *words[1:]]
            continue
        yield path
        if os.path.basename(path) != _ENV:
            return
        started = (at for at, word in enumerate(words) if at and not word.startswith("-") and "=" not in word)
        words = words[next(started, len(words)) :]


def _interpreter(path: str) -> list[str]:
    """The words of the first line of a script; none where the file is no script."""
    try:
        with open(path, "rb") as file:
            line = file.readline(256)
    except OSError:
        return []
    return os.fsdecode(line[2:]).split() if line.startswith(b"#!") else []


def _privileges(program: str) -> str | None:
    """How a process gets privileges by starting ``program``, so that the loader ignores ``LD_PRELOAD``."""
    try:
        status = os.stat(program)
        if os.statvfs(program).f_flag & os.ST_NOSUID:
            return None
    except OSError:
        return None
    if _set_bits_count():
        ways = "declare it with `gate relay` or `gate none`, or take the bit off the file (`chmod"
        if status.st_mode & stat.S_ISUID and status.st_uid != os.getuid():
            return f"is set-user-ID, so the loader ignores `{PRELOAD}`: {ways} u-s`)"
        if status.st_mode & stat.S_ISGID and status.st_mode & stat.S_IXGRP and status.st_gid != os.getgid():
            return f"is set-group-ID, so the loader ignores `{PRELOAD}`: {ways} g-s`)"
    if os.getuid() == 0:
        return None  # it has them anyhow
    try:
        sets = os.getxattr(program, _CAPABILITIES)[4:]
    except OSError:
        return None
    if not any(sets):
        return None
    return (
        f"has file capabilities, so the loader ignores `{PRELOAD}`: declare it with `gate relay` or `gate none`, or "
        "take them off the file (`setcap -r`), and give them to `midstride up` as ambient ones "
        "(`setpriv --ambient-caps`)"
    )


def _set_bits_count() -> bool:
    """Return whether the kernel regards set-user-ID bits for what this process starts."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return True
    return re.search(r"^NoNewPrivs:\s*1$", status, re.MULTILINE) is None
