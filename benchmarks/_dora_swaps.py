"""Swaps of a node by Dora's `node replace`, at 50 Hz: its source is replaced, and a node of Dora records.

Dora is no part of Midstride, and has its own transport; nothing of ROS runs here. As a program, this file is the nodes.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

PERIOD_MS = 20
NAME = "swap"
# How long Dora may take for one command (s).
PATIENCE = 30.0


def source() -> None:
    """Sends its own numbers at 50 Hz, driven by Dora's timer."""
    import pyarrow
    from dora import Node

    node, number = Node(), 0
    for event in node:
        if event["type"] == "INPUT":
            number += 1
            node.send_output("out", pyarrow.array([time.time_ns(), number, os.getpid()], pyarrow.int64()))
        elif event["type"] == "STOP":
            break


def recorder(path: str) -> None:
    """Writes a row for each message to ``path``, as benchmarks/_swap_nodes.py does on ROS."""
    from dora import Node

    node = Node()
    with open(path, "w", encoding="utf-8") as file:
        for event in node:
            if event["type"] == "INPUT":
                sent, number, pid = event["value"].to_pylist()
                print(json.dumps([time.monotonic_ns(), sent, number, str(pid)]), file=file, flush=True)
            elif event["type"] == "STOP":
                break


class Dora:
    """A dataflow of Dora with a source and a recorder; ``programs``: the folder of its command and its Python."""

    def __init__(self, programs: Path, folder: Path) -> None:
        self._programs, self._folder = programs, folder
        self._rows = folder / "rows.jsonl"
        # What it keeps in the home folder is of this run alone.
        self._environment = {**os.environ, "HOME": str(folder), "XDG_CONFIG_HOME": str(folder / "config")}
        self._environment["PATH"] = f"{programs}:{os.environ['PATH']}"
        with socket.create_server(("127.0.0.1", 0)) as door:  # else it may be that of another one
            self._environment["DORA_COORDINATOR_PORT"] = str(door.getsockname()[1])
        self._source = self._node("source", f"source: dora/timer/millis/{PERIOD_MS}", outputs=True)

    def _node(self, name: str, input_: str, outputs: bool, *arguments: str) -> str:
        lines = [
            f"id: {name}",
            f"path: {self._programs / 'python'}",
            f"args: {' '.join([str(Path(__file__).resolve()), name, *arguments])}",
            f"inputs: {{ in: {input_.removeprefix('source: ')} }}",
            *(["outputs: [out]"] if outputs else []),
        ]
        return "\n".join(lines) + "\n"

    def version(self) -> str:
        return self._command("--version").strip()

    def start(self) -> None:
        self._command("up")
        recording = self._node("recorder", "source/out", False, str(self._rows))
        nodes = "".join(_as_item(each) for each in (self._source, recording))
        flow = self._folder / "dataflow.yml"
        flow.write_text(f"nodes:\n{nodes}")
        (self._folder / "source.yml").write_text(self._source)
        self._command("start", str(flow), "--name", NAME, "--detach")
        deadline = time.monotonic() + PATIENCE
        while len(self.rows()) < 50:
            if time.monotonic() > deadline:
                raise SystemExit("Dora's source is not heard")
            time.sleep(0.1)

    def replace(self) -> None:
        self._command("node", "replace", "--dataflow", NAME, "source", "--from-yaml", str(self._folder / "source.yml"))

    def rows(self) -> list[list[Any]]:
        lines = self._rows.read_text(encoding="utf-8").splitlines(keepends=True) if self._rows.exists() else []
        return [json.loads(line) for line in lines if line.endswith("\n")]

    def end(self) -> None:
        self._command("down", "--force")

    def _command(self, *words: str) -> str:
        with tempfile.TemporaryFile("w+", dir=self._folder) as output:  # a pipe would be kept open by its daemons
            done = subprocess.run(
                [self._programs / "dora", *words],
                cwd=self._folder,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                timeout=PATIENCE,
                check=False,
            )
            output.seek(0)
            said = output.read()
        if done.returncode:
            raise SystemExit(f"dora {' '.join(words)}: {said}")
        return said


def _as_item(text: str) -> str:
    first, *rest = text.splitlines()
    return "\n".join([f"  - {first}", *(f"    {line}" for line in rest)]) + "\n"


def replaced_by_dora(programs: Path, swaps: int, timed: Callable[[Callable[[], None]], None]) -> list[list[Any]]:
    """Swap the source so many times; the rows of all that was received."""
    with tempfile.TemporaryDirectory() as name:
        dora = Dora(programs, Path(name))
        try:
            dora.start()
            for _ in range(swaps):

                def swap() -> None:
                    dora.replace()
                    time.sleep(1.5)  # until it certainly sends: the window must hold its first messages

                timed(swap)
            return dora.rows()
        finally:
            dora.end()


if __name__ == "__main__":
    {"source": source, "recorder": recorder}[sys.argv[1]](*sys.argv[2:])
