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

from midstride.foreign.build import STEM
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
AGNOCAST_CERTAIN: Final = 5.0
# Starts its arguments as another program, in its own process, after variables and options; those that a word follows.
_ENV: Final = "env"
_ENV_TAKE_WORDS: Final = {"-u": "--unset", "-C": "--chdir", "-S": "--split-string", "-a": "--argv0"}
# What a process has loaded that uses rcl, and one that has the library of the gate.
_RCL: Final = "/librcl.so"
_GATE: Final = f"/{STEM}"


@dataclass(frozen=True, slots=True)
class StartedPrograms:
    """The programs of one command: its first word, and the one behind its prefix; ``libraries`` that it loads later.

    ``environment`` is that of the process. ``taken_away``: how the command takes ``LD_PRELOAD`` away from what it
    starts, in words.
    """

    programs: tuple[str, ...]
    environment: Mapping[str, str]
    libraries: tuple[str, ...] = ()
    taken_away: str | None = None

    @classmethod
    def of(
        cls, command: Sequence[str], prefix: int, environment: Mapping[str, str], libraries: Sequence[str] = ()
    ) -> StartedPrograms:
        """The programs of ``command``, of which the first ``prefix`` words stand before the program itself."""
        found, taken_away = _run_by(list(command[prefix:]), environment)
        if prefix:
            before, earlier = _run_by(list(command[:prefix]), environment)
            found, taken_away = [*before, *found], earlier or taken_away
        return cls(tuple(dict.fromkeys(found)), environment, tuple(libraries), taken_away)

    def why_not(self, library: Path | None = None) -> str | None:
        """The reason why a gate in the process would hold nothing back, with what to write instead; None if unknown.

        ``library``: that of the gate, where it is there already.
        """
        gate = None if library is None else read_elf(library)
        reasons = (why_not_loaded(program, gate) for program in self.programs)
        return next(filter(None, reasons), None) or self.taken_away or self._agnocast()

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
    """The reason why a process has an endpoint that the library does not see.

    ``certain_after``: how long after its start that is certain (s); None: as long as it runs, it may change.
    """

    why: str
    certain_after: float | None = 0.0


def why_not_loaded(program: str, gate: ElfFile | None = None) -> str | None:
    """The reason why the library of the ``gate`` is not loaded into ``program``, with what to write instead."""
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
    """The reason why the library misses the writes of ``pid`` or a process below it; None where none is known."""
    without: int | None = None
    with_both = False
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
                    certain_after=0.0 if privileged else None,
                )
            loaded = Path(f"/proc/{each}/maps").read_text(errors="replace")
            if _AGNOCAST in loaded:
                return Unseen(_by_agnocast(f"its process {each} has loaded it"), certain_after=AGNOCAST_CERTAIN)
            if (why := why_not_loaded(os.readlink(f"/proc/{each}/exe"))) is not None:
                return Unseen(why, certain_after=None)  # it may start a program that is none
            if _RCL in loaded:
                with_both = with_both or _GATE in loaded
                without = without or (None if _GATE in loaded else each)
    if without is None or with_both:
        return None  # one that has both may be the node, and the others helpers of it
    return Unseen(
        f"its process {without} uses rcl, and was started without the library, as by a script that changes "
        f"`{PRELOAD}`, `env -i` or `sudo`: have that keep the variable, or declare it with `gate relay`"
    )


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
    elf = read_elf(f"/proc/{pid}/exe")
    return is_secure(vector, 64 if elf is None else elf.bits)


def is_secure(vector: bytes, bits: int) -> bool:
    """Return whether the auxiliary vector of a process, whose words have so many ``bits``, has AT_SECURE set."""
    pair = struct.Struct("=II" if bits == 32 else "=QQ")
    whole = vector[: len(vector) // pair.size * pair.size]
    return any(kind == _AT_SECURE and value for kind, value in pair.iter_unpack(whole))


def _by_agnocast(seen: str) -> str:
    return f"what it publishes by Agnocast does not pass the gate ({seen}): declare it with `gate none`"


def _listed(environment: Mapping[str, str]) -> list[str]:
    return [each for each in re.split(r"[:\s]+", environment.get(PRELOAD, "")) if each]


def _run_by(words: list[str], environment: Mapping[str, str]) -> tuple[list[str], str | None]:
    """The paths of the programs that these words start: the interpreter of a script, and what `env` starts.

    Also how `env` takes ``LD_PRELOAD`` away from what it starts, in words; None where it does not.
    """
    found: list[str] = []
    taken_away: str | None = None
    for _ in range(_SCRIPTS):
        if not words or (path := shutil.which(words[0], path=environment.get("PATH"))) is None:
            break
        if interpreter := _interpreter(path):
            words = [*interpreter, path, *words[1:]]
            continue
        found.append(path)
        if os.path.basename(path) != _ENV:
            break
        words, how = _behind_env(words[1:])
        taken_away = taken_away or how
    return found, taken_away


def _behind_env(words: list[str]) -> tuple[list[str], str | None]:
    """The words of the command that `env` starts, and how it takes ``LD_PRELOAD`` away from it, in words."""
    how: str | None = None
    otherwise = f"leave that out (`environment {{ }}` may state `{PRELOAD}`), or declare it with `gate relay`"
    options = True  # up to the first word that is none
    while words:
        word, words = words[0], words[1:]
        if not (options and word.startswith("-")):
            options = False
            name, equals, value = word.partition("=")
            if not equals:
                return [word, *words], how
            if name == PRELOAD:
                how = f"`env {word}` puts another library in the place of the gate's: {otherwise}"
            continue
        option, value, words = _option_of_env(word, words)
        if option == "--split-string":
            words = [*value.split(), *words]
        elif option in ("-", "-i", "--ignore-environment"):
            how = f"`env {option}` takes the library of the gate away (`{PRELOAD}`): {otherwise}"
        elif option == "--unset" and value == PRELOAD:
            how = f"`env -u {PRELOAD}` takes the library of the gate away: {otherwise}"
        options = option not in ("-", "--")
    return [], how


def _option_of_env(word: str, words: list[str]) -> tuple[str, str, list[str]]:
    """An option, by its long name where a word follows it; that word; and the words behind both."""
    if word.startswith("--") or word == "-":
        option, equals, value = word.partition("=")
    else:  # several may stand behind one dash
        option, value = word[:2], word[2:]
        equals = value
        if option in _ENV_TAKE_WORDS:
            option = _ENV_TAKE_WORDS[option]
        elif value:
            return option, "", [f"-{value}", *words]
    if option in _ENV_TAKE_WORDS.values() and not equals and words:
        return option, words[0], words[1:]
    return option, value, words


def _interpreter(path: str) -> list[str]:
    """The words of the first line of a script; none where the file is no script."""
    try:
        with open(path, "rb") as file:
            line = file.readline(256)
    except OSError:
        return []
    return os.fsdecode(line[2:]).split() if line.startswith(b"#!") else []


def _privileges(program: str) -> str | None:
    """The way in which a process gets privileges by starting ``program``, so that the loader ignores ``LD_PRELOAD``."""
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
