"""The library of the gate: prebuilt in the package, else compiled at its first use, into the user's cache.

What tools/wheel builds has it for MACHINES; the sources alone, as a checkout or an sdist, have none.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Final

from midstride.errors import StartFailed

# Its headers and its files in C: all that the folder has.
SOURCES: Final = tuple(
    sorted(path for path in (Path(__file__).parent / "gate").iterdir() if path.suffix in (".c", ".h"))
)
_OPTIONS: Final = "-std=c11 -O2 -shared -fPIC -fvisibility=hidden".split()
_LIBRARIES: Final = ("-lpthread", "-ldl")
# How the name of the library begins.
STEM: Final = "gate-"
# Where the package has the library ready, by machine, as `uname -m` names it.
PREBUILT: Final = Path(__file__).parent / "prebuilt"
MACHINES: Final = ("x86_64", "aarch64")
_ABSENT: Final = "there is none"
# How long the compiler may take (s).
TIMEOUT: Final = 60.0


def compiler(environment: Mapping[str, str] = os.environ) -> list[str] | None:
    """The command of the C compiler: that of ``CC``, else the first of the usual ones; None where there is none."""
    if named := environment.get("CC", "").split():
        return named if shutil.which(named[0], path=environment.get("PATH")) else None
    found = (shutil.which(name, path=environment.get("PATH")) for name in ("cc", "gcc", "clang"))
    return next(([path] for path in found if path), None)


def is_available(environment: Mapping[str, str] = os.environ) -> bool:
    """Return whether there is a library for this machine, or a compiler for it."""
    return library_path(environment).exists() or compiler(environment) is not None


def library(environment: Mapping[str, str] = os.environ) -> Path:
    """The library for this machine: the prebuilt one, else one that is compiled at its first use. Raises StartFailed.

    Its name has the hash of the sources. Of two processes that compile it at once, each puts a whole file in its place.
    """
    path = library_path(environment)
    if path.exists():
        return path
    command = compiler(environment)
    if command is None:
        raise StartFailed(
            f"`gate preload` needs a library that is not here ({_why_not_prebuilt()}), and there is "
            "no C compiler on the PATH to make it: install one (`apt-get install gcc libc6-dev`), name it in CC, or "
            "write `gate relay`, which needs none"
        )
    if not _are_own():
        raise StartFailed(
            f"`gate preload` needs a library that is not here, {path}: the files of Midstride have changed since this "
            "process was started, as by an upgrade; write `midstride down` and `midstride up`"
        )
    compile_library(command, path, environment)
    return path


def compile_library(command: Sequence[str], path: Path, environment: Mapping[str, str] = os.environ) -> None:
    """Compile the library into ``path`` by the compiler ``command``. Raises StartFailed, with what it says."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            output = Path(folder) / path.name
            arguments = [*command, *_OPTIONS, "-o", str(output), *_compiled(), *_LIBRARIES]
            done = subprocess.run(
                arguments, env=dict(environment), capture_output=True, text=True, timeout=TIMEOUT, check=False
            )
            if done.returncode:
                raise StartFailed(
                    "the gate cannot be compiled; write `gate relay`, which needs no compiler, or correct what "
                    f"`{' '.join(arguments)}` says\n{done.stderr.strip()}"
                )
            output.replace(path)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise StartFailed(f"the gate cannot be compiled: {error}; or write `gate relay`") from None


def origin(environment: Mapping[str, str] = os.environ) -> str:
    """The origin of the library for this machine, and the reason for it, in words."""
    path = library_path(environment)
    if path == prebuilt_path():
        return f"the prebuilt one of the package, {path}"
    return f"compiled here ({_why_not_prebuilt()}), {path}"


def _compiled() -> list[str]:
    return [str(source) for source in SOURCES if source.suffix == ".c"]


def library_path(environment: Mapping[str, str]) -> Path:
    """The path of the library, once it is compiled."""
    prebuilt = prebuilt_path()
    return prebuilt if why_unfit(prebuilt) is None else _cache(environment) / prebuilt.name


def prebuilt_path(machine: str = platform.machine()) -> Path:
    """The path of the package's library for a ``machine``, made from the sources as they are; it may not exist."""
    return PREBUILT / library_name(machine)


def library_name(machine: str) -> str:
    """The name of the library for a ``machine``, with the hash of the sources and options that it is made from."""
    return f"{STEM}{_OWN}-{machine}.so"


def _why_not_prebuilt() -> str:
    why = why_unfit(prebuilt_path())
    machine = platform.machine()
    return f"the package has none for {machine}" if why == _ABSENT else f"the one for {machine} cannot be loaded: {why}"


def why_unfit(path: Path) -> str | None:
    """The reason why a library cannot be loaded here, such as a C library older than it needs; None where it can."""
    return _why_not_loaded(path) if path.exists() else _ABSENT


@cache
def _why_not_loaded(path: Path) -> str | None:
    try:
        ctypes.CDLL(str(path))
    except OSError as error:
        return str(error)
    return None


def _cache(environment: Mapping[str, str]) -> Path:
    base = environment.get("XDG_CACHE_HOME") or os.path.join(environment.get("HOME") or tempfile.gettempdir(), ".cache")
    return Path(base) / "midstride"


def _are_own() -> bool:
    """Return whether the sources are still those that were there as this process began."""
    try:
        return _digest() == _OWN
    except OSError:
        return False


def _digest() -> str:
    digest = hashlib.sha256(" ".join((*_OPTIONS, *_LIBRARIES)).encode())
    for source in SOURCES:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


# As this process has begun, which may go on with its code after an upgrade: another version's library is not used.
_OWN: Final = _digest()
