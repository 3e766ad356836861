"""Systems whose publisher Midstride replaces, and one that is up: by the command line, and over its API."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from midstride.cli.client import Client
from midstride.runtime.records.reports import Outcome

from .streams import PATIENCE, TYPE, Host, Stream, SwapFailed

NAME = "swap_benchmark"


def with_api(nodes: Path, stream: Stream, queue: int = 10) -> str:
    """The specification of a source with Midstride's API, and a sink that relies on it.

    Two names of one program: a swap there and back is a swap all the same. ``queue``: how many messages wait for
    the sink.
    """
    rate, size = stream.words
    return f"""system {NAME}

topic /swap : {TYPE} @ {rate} Hz

component Source {{
  run "python3 {nodes} source source {rate} {size}"
  output out
  functionality talk {{
    produces out
    mode normal {{ guarantee out : {TYPE} @ {rate} Hz }}
    mode degraded {{ }}
  }}
}}
component OtherSource like Source {{ run "python3 {nodes} source other {rate} {size}" }}

component Sink {{
  run "python3 {nodes} sink {rate} {queue}"
  input in : {TYPE} @ {rate} Hz qos(depth = {queue})
  functionality listen {{
    uses in
    mode normal {{ assume in }}
    mode degraded {{ }}
  }}
}}

node source : Source {{ out -> /swap }}
node sink   : Sink   {{ in <- /swap }}
"""


def without_api(command: Sequence[str], gate: str, stream: Stream) -> str:
    """The specification of a source that is a plain node on `chatter`, behind a gate; ``command`` starts it.

    It guarantees nine tenths of its rate: a timer keeps no exact rate.
    """
    contract = f"{TYPE} @ {0.9 * stream.rate:g} Hz"
    run = f'run "{" ".join(command)}" gate {gate}'
    return f"""system {NAME}

topic /swap : {contract}

component Source {{
  {run}
  output out as chatter
  functionality talk {{
    produces out
    mode normal {{ guarantee out : {contract} }}
    mode degraded {{ }}
  }}
}}
component OtherSource like Source {{ {run} }}

node source : Source {{ out -> /swap }}
"""


class System:
    """A system of which the node `source` is replaced, by turns, with `OtherSource` and `Source`."""

    def __init__(self, host: Host, text: str, folder: Path) -> None:
        """``folder``: for all that its manager keeps; a short path, since it is that of sockets too."""
        self._host = host
        self._env = {**host.env, "XDG_RUNTIME_DIR": str(folder)}
        self._file = folder / "swap.stride"
        self._file.write_text(text, encoding="utf-8")
        self._folder = folder / "midstride" / NAME
        self._next, self._other = "OtherSource", "Source"

    @property
    def socket(self) -> Path:
        """The socket of its manager."""
        return self._folder / "manager.sock"

    @property
    def manager(self) -> int:
        """The process of its manager."""
        return int((self._folder / "lock").read_text())

    def command(self, *words: str, **more: Any) -> subprocess.Popen[str]:
        """Start `midstride` for this system, with its output in a pipe."""
        command = [sys.executable, "-m", "midstride", *words]
        return subprocess.Popen(command, env=self._env, stdout=subprocess.PIPE, text=True, **more)

    def _done(self, *words: str) -> tuple[int, str]:
        with tempfile.TemporaryFile("w+") as output:  # what it leaves running would keep a pipe open
            command = [sys.executable, "-m", "midstride", *words]
            done = subprocess.run(
                command, env=self._env, stdout=output, stderr=subprocess.STDOUT, check=False, timeout=3 * PATIENCE
            )
            output.seek(0)
            return done.returncode, output.read()

    @contextmanager
    def up(self) -> Iterator[None]:
        """The system is up, while inside. Raises SwapFailed if it does not come up."""
        try:
            status, said = self._done("up", str(self._file), "--backend", self._host.backend, "--detach")
            if status:
                raise SwapFailed(f"midstride up: {said}")
            yield
        finally:
            self._done("down", "--system", NAME)

    def change(self, strategy: str = "minimal") -> Outcome:
        """Replace the source. Raises SwapFailed if nothing came of it; a roll-back is an outcome."""
        request = {"replace": [["source", self._next]], "strategy": strategy}
        outcome = Client(self.socket).change({"request": request})
        if outcome.outcome == "done":
            self._next, self._other = self._other, self._next
        elif outcome.outcome != "rolled_back":
            raise SwapFailed(f"{outcome.outcome}: {outcome.because}")
        return outcome


@contextmanager
def running(host: Host, text: str) -> Iterator[System]:
    """A system of this text that is up, with its own folders."""
    with tempfile.TemporaryDirectory(prefix="ms") as folder:
        system = System(host, text, Path(folder))
        with system.up():
            yield system
