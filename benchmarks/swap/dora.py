"""Dora's `node replace`: a source of a dataflow is replaced, and a node of Dora records.

Dora is no part of ROS or Midstride, and has its own transport.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .streams import PATIENCE, SwapFailed
from .ways import Setting, Swap, Way

FLOW = "swap"
# Where its processes find each other.
PORT = "DORA_COORDINATOR_PORT"
NODES = Path(__file__).resolve().parent / "programs" / "dora_nodes.py"
PACKAGES = ("dora-rs==1.1.0", "dora-rs-cli==1.1.0")


class Flow:
    """A dataflow of Dora with a source and a recorder; ``programs``: the folder of its command and its Python."""

    def __init__(self, programs: Path, setting: Setting) -> None:
        self._programs, self._folder = programs, setting.folder
        # What it keeps in the home folder is of this run alone.
        self._env = {**os.environ, "HOME": str(self._folder), "XDG_CONFIG_HOME": str(self._folder / "config")}
        self._env["PATH"] = f"{programs}:{os.environ['PATH']}"
        with socket.create_server(("127.0.0.1", 0)) as door:  # else it may be that of another one
            self._env[PORT] = str(door.getsockname()[1])
        timer = f"dora/timer/millis/{round(1000 * setting.stream.period)}"
        self._source = self._node("source", timer, True, str(setting.stream.size))
        self._recorder = self._node("recorder", "source/out", False, str(setting.rows.absolute()))

    def _node(self, name: str, input_: str, outputs: bool, *arguments: str) -> str:
        lines = [
            f"id: {name}",
            f"path: {self._programs / 'python'}",
            f"args: {' '.join([str(NODES), name, *arguments])}",
            f"inputs: {{ in: {input_} }}",
            *(["outputs: [out]"] if outputs else []),
        ]
        return "\n".join(lines) + "\n"

    def start(self) -> None:
        """Start Dora, and the dataflow."""
        self._command("up")
        flow = self._folder / "dataflow.yml"
        flow.write_text("nodes:\n" + "".join(map(_as_item, (self._source, self._recorder))))
        (self._folder / "source.yml").write_text(self._source)
        self._command("start", str(flow), "--name", FLOW, "--detach")

    def replace(self) -> None:
        """Replace the source by one of the same description."""
        self._command("node", "replace", "--dataflow", FLOW, "source", "--from-yaml", str(self._folder / "source.yml"))

    def end(self) -> None:
        """End all of it; what Dora does not end itself is killed."""
        import psutil

        with contextlib.suppress(SwapFailed, subprocess.TimeoutExpired):  # it fails where a node is slow to stop
            self._command("down", "--force")
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error):
                if process.environ().get(PORT) == self._env[PORT]:
                    process.kill()

    def _command(self, *words: str) -> None:
        with tempfile.TemporaryFile("w+", dir=self._folder) as output:  # a pipe would be kept open by its daemons
            done = subprocess.run(
                [self._programs / "dora", *words],
                cwd=self._folder,
                env=self._env,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                timeout=PATIENCE,
                check=False,
            )
            output.seek(0)
            said = output.read()
        if done.returncode:
            raise SwapFailed(f"dora {' '.join(words)}: {said}")


def _as_item(text: str) -> str:
    first, *rest = text.splitlines()
    return "\n".join([f"  - {first}", *(f"    {line}" for line in rest)]) + "\n"


def install(folder: Path) -> Path:
    """The programs of the virtual environment ``folder``, which is made, with Dora in it, if it is not there."""
    programs = folder.absolute() / "bin"
    if not (programs / "dora").exists():
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
        subprocess.run([programs / "python", "-m", "pip", "install", "-q", *PACKAGES], check=True)
    return programs


class NodeReplace(Way):
    """`dora node replace` of a source that Dora's timer drives, on Dora's own transport."""

    name, title, seconds = "dora", "Dora's `node replace` (not ROS)", 2.0
    records = True

    def missing(self, setting: Setting) -> str | None:
        if setting.dora is None:
            return "`--dora FOLDER` names no virtual environment for it"
        if (1000 * setting.stream.period) % 1:
            return f"Dora's timer has whole milliseconds, which {setting.stream.rate:g} Hz does not have"
        return None

    @contextmanager
    def running(self, setting: Setting) -> Iterator[Swap]:
        assert setting.dora is not None
        flow = Flow(install(setting.dora), setting)
        try:
            flow.start()
            yield flow.replace
        finally:
            flow.end()
