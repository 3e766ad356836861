"""The Alloy Analyzer as a subprocess: found, started, bounded in time, read.

This is the only module of `verify` that starts processes. Where the Analyzer or Java is missing, or does not
answer, that is an error with its reason; it is never taken for a pass.
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
from dataclasses import dataclass, field
from functools import cache
from hashlib import sha256
from pathlib import Path
from threading import Event
from typing import Any, Final

import psutil

from midstride.errors import AlloyFailed, AlloyMissing

VERSION: Final = "6.2.0"
SHA256: Final = "6037cbeee0e8423c1c468447ed10f5fcf2f2743a2ffc39cb1c81f2905c0fdb9d"
ARTIFACT: Final = f"org.alloytools:org.alloytools.alloy.dist:{VERSION}"
JAR: Final = f"org.alloytools.alloy.dist-{VERSION}.jar"
VARIABLE: Final = "MIDSTRIDE_ALLOY"
JAVA: Final = 17
# How long a dump may take (s), where nothing else is said; a check of the specification has its own.
TIME_LIMIT: Final = 300.0
_GRACE: Final = 2.0
_LOOK: Final = 0.2

_HOW: Final = (
    f"`make alloy` fetches it (with Maven, {ARTIFACT}); or name the file with --alloy or the variable {VARIABLE}"
)


@dataclass(frozen=True, slots=True)
class SolverOutcome:
    """What one command came to: whether it has an instance, and the instance's fields, atom by atom."""

    satisfiable: bool
    values: Mapping[str, Mapping[str, list[list[str]]]] = field(default_factory=dict)
    skolems: Mapping[str, list[list[str]]] = field(default_factory=dict)
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class Alloy:
    """An Alloy Analyzer that is there. ``told`` names it; a file other than the one checked here is said to be."""

    java: str
    jar: Path
    told: str

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
        """Execute the commands of a file whose names fit the pattern, in one process.

        ``limit`` bounds the whole (s), ``memory`` the Java heap (MiB); ``quick`` is for what is solved in seconds,
        where starting up is what takes the time. Raises AlloyFailed, with the reason, where no answer comes.
        """
        with tempfile.TemporaryDirectory(prefix="midstride-alloy-") as folder:
            options = [*(["-XX:TieredStopAtLevel=1"] if quick else []), *([f"-Xmx{memory}m"] if memory else [])]
            output = Path(folder) / "out"
            line = [*self._java(folder, *options), "exec", "-q", "-f", "-t", "json", "-s", solver, "-o", str(output)]
            return self._execute([*line, "-c", commands, str(source)], output, limit, stop)

    def solvers(self) -> list[str]:
        """The solvers that can be had on this machine. Raises AlloyFailed where no answer comes."""
        with tempfile.TemporaryDirectory(prefix="midstride-alloy-") as folder:
            return run([*self._java(folder), "solvers", "-l"], 60.0).text.split()

    def _java(self, folder: str, *options: str) -> list[str]:
        """How a command of the Analyzer begins. It leaves files in its temporary folder: that is ``folder``."""
        headless = "-Djava.awt.headless=true"
        return [self.java, f"-Djava.io.tmpdir={folder}", headless, "-XX:+UseSerialGC", *options, "-jar", str(self.jar)]

    def _execute(self, line: Sequence[str], output: Path, limit: float, stop: Event | None) -> dict[str, SolverOutcome]:
        said = run(line, limit, stop)
        receipt = output / "receipt.json"
        if said.code != 0 or not receipt.is_file():
            raise AlloyFailed(_reason(said.text))
        try:
            document = json.loads(receipt.read_text(encoding="utf-8"))
            return {name: _outcome(entry) for name, entry in document["commands"].items()}
        except (ValueError, KeyError, TypeError, OSError) as error:
            raise AlloyFailed(f"Alloy's answer cannot be read ({type(error).__name__}: {error})") from error


@dataclass(frozen=True, slots=True)
class AlloyOutput:
    """How a process ended, and what it wrote."""

    code: int
    text: str


def run(line: Sequence[str], limit: float, stop: Event | None = None) -> AlloyOutput:
    """A process in a group of its own. After ``limit`` (s), or by ``stop``, it ends with its children: AlloyFailed."""
    try:
        process = subprocess.Popen(
            line, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
        )
    except OSError as error:
        raise AlloyMissing(f"{line[0]} cannot be started: {error}") from error
    try:
        text = _listened(process, limit, stop)
    finally:
        if process.poll() is None:
            _end(process)
    return AlloyOutput(process.returncode, text.decode("utf-8", "replace"))


def _listened(process: subprocess.Popen[bytes], limit: float, stop: Event | None) -> bytes:
    """What the process writes until its end. Only where somebody may set ``stop`` is it looked at, now and then."""
    end = time.monotonic() + limit
    while (left := end - time.monotonic()) > 0:
        try:
            return process.communicate(timeout=left if stop is None else min(left, _LOOK))[0]
        except subprocess.TimeoutExpired:
            if stop is not None and stop.is_set():
                raise AlloyFailed("stopped") from None
    raise AlloyFailed(f"no answer within {limit:g} s")


def _end(process: subprocess.Popen[bytes]) -> None:
    for number in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(process.pid, number)
            process.wait(_GRACE)
            break
        except subprocess.TimeoutExpired:
            continue
        except ProcessLookupError:
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
    """What Alloy complains of, without its stack."""
    if "OutOfMemoryError" in text:
        return "Alloy ran out of memory"
    lines = [line for line in text.splitlines() if line.strip() and not _NOISE.match(line)]
    return " ".join(dict.fromkeys(line.strip() for line in lines)) or "Alloy ended without an answer"


# -- finding it --------------------------------------------------------------------------------------------


def find(named: Path | None = None) -> Alloy:
    """The Analyzer: ``named``, else what the environment names, else what `make alloy` has fetched.

    Raises AlloyMissing, which says what is missing and how to get it.
    """
    jar = _jar(named)
    java = _java()
    return Alloy(java, jar, f"Alloy {VERSION}" if digest(jar) == SHA256 else f"the Alloy of {jar}")


def _jar(named: Path | None) -> Path:
    chosen = named or (Path(os.environ[VARIABLE]) if os.environ.get(VARIABLE) else None)
    if chosen is not None:
        if chosen.is_dir():
            chosen = chosen / JAR
        if not chosen.is_file():
            raise AlloyMissing(f"there is no Alloy Analyzer at {chosen}: {_HOW}")
        return chosen
    for place in places():
        if (place / JAR).is_file():
            if digest(place / JAR) != SHA256:
                raise AlloyMissing(f"{place / JAR} is not Alloy {VERSION} (its SHA-256 differs): remove it, and {_HOW}")
            return place / JAR
    raise AlloyMissing(f"the Alloy Analyzer {VERSION} is not here: {_HOW}")


def places() -> list[Path]:
    """Where it is looked for: beside the Makefile of a checkout (`make alloy`), and in the user's cache."""
    checkout = Path(__file__).resolve().parents[3]
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    beside = [checkout / ".cache" / "alloy"] if (checkout / "Makefile").is_file() else []
    return [*beside, home / "midstride" / "alloy"]


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
        raise AlloyMissing(f"there is no Java here, and the Alloy Analyzer needs Java {JAVA} or later (a JRE will do)")
    version = _java_version(java)
    if version is not None and version < JAVA:
        raise AlloyMissing(f"{java} is Java {version}, and the Alloy Analyzer needs Java {JAVA} or later")
    return java


@cache
def _java_version(java: str) -> int | None:
    try:
        found = re.search(r'version "(?:1\.)?(\d+)', run([java, "-version"], 60.0).text)
    except AlloyFailed:
        return None
    return int(found[1]) if found else None


@cache
def fast_solver(alloy: Alloy) -> str:
    """The quickest solver that this machine has: a native one where there is one."""
    try:
        return "glucose" if "glucose" in alloy.solvers() else "sat4j"
    except AlloyFailed:
        return "sat4j"


def available_memory() -> int:
    """Memory that can be used without swapping (MiB)."""
    return int(psutil.virtual_memory().available) // 2**20
