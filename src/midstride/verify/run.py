"""Finds the Alloy Analyzer, runs it as a subprocess with a time limit, and reads its answer.

No other module of `verify` starts processes. A missing Analyzer or Java, or no answer, is an error with its reason,
never a pass.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from hashlib import sha256
from pathlib import Path
from threading import Event
from typing import Any, Final

from midstride.errors import AlloyFailed, AlloyMissing

VERSION: Final = "6.2.0"
SHA256: Final = "6037cbeee0e8423c1c468447ed10f5fcf2f2743a2ffc39cb1c81f2905c0fdb9d"
ARTIFACT: Final = f"org.alloytools:org.alloytools.alloy.dist:{VERSION}"
JAR: Final = f"org.alloytools.alloy.dist-{VERSION}.jar"
VARIABLE: Final = "MIDSTRIDE_ALLOY"
JAVA: Final = 17
# The default time limit of a dump (s).
TIME_LIMIT: Final = 300.0
# How long a process may take to end on SIGTERM, and how often a stop event is looked at (s).
_STOP_TIMEOUT: Final = 2.0
_POLL: Final = 0.2

_HOW_TO_GET: Final = (
    f"`make alloy` fetches it (with Maven, {ARTIFACT}); or give the file with --alloy or the variable {VARIABLE}"
)


@dataclass(frozen=True, slots=True)
class SolverOutcome:
    """The result of one command: whether it has an instance, and the instance's fields, atom by atom."""

    satisfiable: bool
    values: Mapping[str, Mapping[str, list[list[str]]]] = field(default_factory=dict)
    skolems: Mapping[str, list[list[str]]] = field(default_factory=dict)
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class Alloy:
    """An installed Alloy Analyzer. ``name`` is its version, or the file if that is not the release known here."""

    java: str
    jar: Path
    name: str

    def solve(
        self,
        source: Path,
        commands: str = "*",
        *,
        limit: float = TIME_LIMIT,
        solver: str = "sat4j",
        memory: int | None = None,
        quick: bool = True,
        stop: Event | None = None,
    ) -> dict[str, SolverOutcome]:
        """Execute the commands of a file whose names match the pattern, in one process.

        ``limit`` bounds the total time (s), ``memory`` the Java heap (MiB); ``quick`` saves start-up time for problems
        that are solved in seconds. Raises AlloyFailed, with the reason, where there is no answer.
        """
        with tempfile.TemporaryDirectory(prefix="midstride-alloy-") as folder:
            options = [*(["-XX:TieredStopAtLevel=1"] if quick else []), *([f"-Xmx{memory}m"] if memory else [])]
            output = Path(folder) / "out"
            line = [*self._java(folder, *options), "exec", "-q", "-f", "-t", "json", "-s", solver, "-o", str(output)]
            status, text = run([*line, "-c", commands, str(source)], limit, stop)
            receipt = output / "receipt.json"
            if status != 0 or not receipt.is_file():
                raise AlloyFailed(_reason(text))
            try:
                document = json.loads(receipt.read_text(encoding="utf-8"))
                return {name: _outcome(entry) for name, entry in document["commands"].items()}
            except (ValueError, KeyError, TypeError, OSError) as error:
                raise AlloyFailed(f"cannot read Alloy's answer ({type(error).__name__}: {error})") from error

    def solvers(self) -> list[str]:
        """The solvers available on this machine. Raises AlloyFailed where there is no answer."""
        with tempfile.TemporaryDirectory(prefix="midstride-alloy-") as folder:
            return run([*self._java(folder), "solvers", "-l"], 60.0)[1].split()

    def _java(self, folder: str, *options: str) -> list[str]:
        """The start of a command line of the Analyzer, with ``folder`` for its temporary files."""
        headless = "-Djava.awt.headless=true"
        return [self.java, f"-Djava.io.tmpdir={folder}", headless, "-XX:+UseSerialGC", *options, "-jar", str(self.jar)]


def run(line: Sequence[str], limit: float, stop: Event | None = None) -> tuple[int, str]:
    """The exit status and the output of a process, which runs in its own group.

    After ``limit`` (s), or on ``stop``, kills the group and raises AlloyFailed. Raises AlloyMissing if it cannot start.
    """
    try:
        process = subprocess.Popen(
            line, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
        )
    except OSError as error:
        raise AlloyMissing(f"cannot start {line[0]}: {error}") from error
    try:
        text = _output(process, limit, stop)
    finally:
        if process.poll() is None:
            _kill(process)
    return process.returncode, text.decode("utf-8", "replace")


def _output(process: subprocess.Popen[bytes], limit: float, stop: Event | None) -> bytes:
    """Read what the process writes until it ends. Polls ``stop`` only if it is given."""
    end = time.monotonic() + limit
    while (left := end - time.monotonic()) > 0:
        try:
            return process.communicate(timeout=left if stop is None else min(left, _POLL))[0]
        except subprocess.TimeoutExpired:
            if stop is not None and stop.is_set():
                raise AlloyFailed("stopped") from None
    raise AlloyFailed(f"no answer within {limit:g} s")


def _kill(process: subprocess.Popen[bytes]) -> None:
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError, subprocess.TimeoutExpired):
            os.killpg(process.pid, number)
            process.wait(_STOP_TIMEOUT)
            break
    if process.stdout is not None:
        process.stdout.close()


def _outcome(entry: Mapping[str, Any]) -> SolverOutcome:
    solutions = entry.get("solution") or []
    if not solutions:
        return SolverOutcome(False)
    first = solutions[0]
    instance = first["instances"][0]
    skolems = {name: value["data"] for name, value in (instance.get("skolems") or {}).items()}
    return SolverOutcome(True, instance["values"], skolems, first.get("duration", 0) / 1000)


_NOISE: Final = re.compile(r"^(\s+at |\s+\.\.\. |\[main\] ERROR|Error$|\s*\d+\. \[)")


def _reason(text: str) -> str:
    """Alloy's error message, without its stack trace."""
    if "OutOfMemoryError" in text:
        return "Alloy ran out of memory"
    lines = [line for line in text.splitlines() if line.strip() and not _NOISE.match(line)]
    return " ".join(dict.fromkeys(line.strip() for line in lines)) or "Alloy ended without an answer"


def find(named: Path | None = None) -> Alloy:
    """The Analyzer: ``named``, else that of the environment variable, else the one that `make alloy` fetched.

    Raises AlloyMissing, with what is missing and how to get it.
    """
    jar = _jar(named)
    java = _java()
    return Alloy(java, jar, f"Alloy {VERSION}" if digest(jar) == SHA256 else f"Alloy from {jar}")


def _jar(named: Path | None) -> Path:
    chosen = named or (Path(os.environ[VARIABLE]) if os.environ.get(VARIABLE) else None)
    if chosen is not None:
        if chosen.is_dir():
            chosen = chosen / JAR
        if not chosen.is_file():
            raise AlloyMissing(f"there is no Alloy Analyzer at {chosen}: {_HOW_TO_GET}")
        return chosen
    for folder in jar_folders():
        if (jar := folder / JAR).is_file():
            if digest(jar) != SHA256:
                raise AlloyMissing(f"{jar} is not Alloy {VERSION} (its SHA-256 differs): remove it, and {_HOW_TO_GET}")
            return jar
    raise AlloyMissing(f"the Alloy Analyzer {VERSION} is not installed: {_HOW_TO_GET}")


def jar_folders() -> list[Path]:
    """The folders in which to look for it: the cache of a checkout (`make alloy`) and that of the user."""
    checkout = Path(__file__).resolve().parents[3]
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    in_checkout = [checkout / ".cache" / "alloy"] if (checkout / "Makefile").is_file() else []
    return [*in_checkout, home / "midstride" / "alloy"]


def digest(path: Path) -> str:
    stat = path.stat()
    return _digest(path, stat.st_size, stat.st_mtime_ns)


@cache
def _digest(path: Path, size: int, changed: int) -> str:
    return sha256(path.read_bytes()).hexdigest()


def _java() -> str:
    home = os.environ.get("JAVA_HOME")
    java = shutil.which("java", path=str(Path(home) / "bin")) if home else None
    java = java or shutil.which("java")
    if java is None:
        raise AlloyMissing(f"Java is not installed; the Alloy Analyzer needs Java {JAVA} or later (a JRE is enough)")
    version = _java_version(java)
    if version is not None and version < JAVA:
        raise AlloyMissing(f"{java} is Java {version}; the Alloy Analyzer needs Java {JAVA} or later")
    return java


@cache
def _java_version(java: str) -> int | None:
    try:
        found = re.search(r'version "(?:1\.)?(\d+)', run([java, "-version"], 60.0)[1])
    except AlloyFailed:
        return None
    return int(found[1]) if found else None


@cache
def fast_solver(alloy: Alloy) -> str:
    """The fastest solver on this machine: a native one if there is one."""
    try:
        return "glucose" if "glucose" in alloy.solvers() else "sat4j"
    except AlloyFailed:
        return "sat4j"
