"""Compiles the library of the gate at its first use, into the user's cache."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from midstride.errors import StartFailed

# Its headers and its files in C: all that the folder has.
SOURCES: Final = tuple(
    sorted(path for path in (Path(__file__).parent / "gate").iterdir() if path.suffix in (".c", ".h"))
)
_OPTIONS: Final = "-std=c11 -O2 -shared -fPIC -fvisibility=hidden".split()
_LIBRARIES: Final = ("-lpthread", "-ldl")
# How long the compiler may take (s).
TIMEOUT: Final = 60.0


def compiler(environment: Mapping[str, str] = os.environ) -> list[str] | None:
    """The command of the C compiler: that of ``CC``, else the first of the usual ones; None where there is none."""
    if named := environment.get("CC", "").split():
        return named if shutil.which(named[0], path=environment.get("PATH")) else None
    found = (shutil.which(name, path=environment.get("PATH")) for name in ("cc", "gcc", "clang"))
    return next(([path] for path in found if path), None)


def is_available(environment: Mapping[str, str] = os.environ) -> bool:
    """Return whether the library is compiled, or there is a compiler for it."""
    return library_path(environment).exists() or compiler(environment) is not None


def library(environment: Mapping[str, str] = os.environ) -> Path:
    """The compiled library for this machine, compiled if it is not in the cache. Raises StartFailed.

    Its name has the hash of the sources. Of two processes that compile it at once, each puts a whole file in its place.
    """
    path = library_path(environment)
    if path.exists():
        return path
    command = compiler(environment)
    if command is None:
        raise StartFailed(
            "`gate preload` needs a C compiler, and there is none on the PATH: install one "
            "(`apt-get install gcc libc6-dev`), name it in CC, or write `gate relay`, which needs none"
        )
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
    return path


def _compiled() -> list[str]:
    return [str(source) for source in SOURCES if source.suffix == ".c"]


def library_path(environment: Mapping[str, str]) -> Path:
    """Where the compiled library is, or will be."""
    return _cache(environment) / f"gate-{_digest()}-{platform.machine()}.so"


def _cache(environment: Mapping[str, str]) -> Path:
    base = environment.get("XDG_CACHE_HOME") or os.path.join(environment.get("HOME") or tempfile.gettempdir(), ".cache")
    return Path(base) / "midstride"


def _digest() -> str:
    digest = hashlib.sha256(" ".join((*_OPTIONS, *_LIBRARIES)).encode())
    for source in SOURCES:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]
