"""`midstride dev` on ROS 2: how long from a save to the first message of the new code, or to the reason on the screen.

A bare rclpy subscriber records a talker that counts and hands its count on. Each save writes another version of it; it
says its version in each message, and no number may be missing. Then faulty versions are saved, which are rejected.
The folder is watched by a `midstride dev` as a user starts it.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from _guard import guard
from _recorder import recording

SPECIFICATION = """system dev_bench

contract Text = std_msgs/msg/String @ {rate} Hz

topic /counted : Text

component Talker {{
  run "python3 talker.py"
  output out
  functionality talk {{
    produces out
    mode normal {{ guarantee out : Text }}
    mode degraded {{ }}
  }}
}}

component Listener {{
  run "python3 listener.py"
  input in : Text
  functionality listen {{
    uses in
    mode normal {{ assume in }}
    mode degraded {{ }}
  }}
}}

node talker   : Talker   {{ out -> /counted }}
node listener : Listener {{ in <- /counted }}
"""
TALKER = """from std_msgs.msg import String

from midstride import Component

comp = Component("talker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
count = 0


def normal() -> None:
    global count
    count += 1
    out.write(String(data=f"{version} {{count}}"))


@comp.on_export_state
def export() -> bytes:
    return str(count).encode()


@comp.on_import_state
def import_(state: bytes) -> None:
    global count
    count = int(state)


talk.set_normal_mode(normal, rate={rate}, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""
LISTENER = """from std_msgs.msg import String

from midstride import Component

comp = Component("listener")
heard = comp.create_input("in", String, rate={rate})
listen = comp.create_functionality("listen", inputs=[heard])
listen.set_normal_mode(lambda message: None, inputs=[heard])
listen.set_degraded_mode(lambda: None)
comp.start()
"""
# What is written into the talker's program, and what is then on the screen.
FAULTS = {
    "a syntax error": ("def normal()", "def normal(", "SyntaxError"),
    "an import error": ("from midstride", "import no_such_module\nfrom midstride", "No module named 'no_such_module'"),
    "an exception on the third call": (
        "    count += 1\n",
        "    count += 1\n    calls.append(1)\n    if len(calls) == 3:\n        raise ValueError('the third call')\n",
        "ValueError: the third call",
    ),
    "no message at all": ("    out.write(", "    str(", "has written nothing within"),
}
# Those with a traceback: for the last one, the new code has its time to write something.
RAISING = tuple(FAULTS)[:3]
# How long anything may take (s), on a busy machine.
PATIENCE = 60.0


class Heard(NamedTuple):
    """A message: when it came (unix s), the version of the code that wrote it, and its number."""

    at: float
    version: str
    number: int


@dataclass
class Bench:
    """A folder that `midstride dev` watches, and what a bare subscriber has heard from its talker."""

    folder: Path
    rate: float
    heard: list[Heard] = field(default_factory=list)
    environment: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        (self.folder / "dev_bench.stride").write_text(SPECIFICATION.format(rate=f"{self.rate:g}"))
        (self.folder / "listener.py").write_text(LISTENER.format(rate=self.rate))
        self.save(self.talker("v0"))
        runtime = self.folder / "run"
        runtime.mkdir()
        self.environment = {**os.environ, "XDG_RUNTIME_DIR": str(runtime)}

    def talker(self, version: str) -> str:
        return TALKER.format(version=version, rate=self.rate)

    def faulty(self, fault: str) -> str:
        """The talker with one of ``FAULTS``."""
        old, new, _ = FAULTS[fault]
        text = self.talker("faulty").replace("count = 0\n", "count = 0\ncalls = []\n")
        if text.count(old) != 1:
            raise ValueError(f"{fault} does not fit the talker: {old!r}")
        return text.replace(old, new)

    def refused(self, fault: str, number: int) -> float:
        """Save faulty code, another text for each number. The seconds until its traceback is on the screen."""
        seen, words = len(self.screen()), FAULTS[fault][2]
        saved = self.save(f"{self.faulty(fault)}# {number}\n")
        self.until(lambda: words in self.screen()[seen:], f"{fault}: {words}")
        return time.time() - saved

    def save(self, text: str) -> float:
        """Save the talker's program as many editors do, by a rename. When (unix s)."""
        written = self.folder / "talker.py~"
        written.write_text(text)
        at = time.time()
        written.replace(self.folder / "talker.py")
        return at

    def screen(self) -> str:
        """What `midstride dev` has printed."""
        return (self.folder / "screen.txt").read_text(errors="replace")

    def until(self, condition: Callable[[], Any], what: str) -> Any:
        """The first true value of ``condition``."""
        deadline = time.monotonic() + PATIENCE
        while not (value := condition()):
            if time.monotonic() > deadline:
                raise TimeoutError(f"{what} within {PATIENCE:g} s; on the screen:\n{self.screen()}")
            time.sleep(0.005)
        return value

    def first(self, version: str) -> Heard:
        """The first message of a version."""
        found: Heard = self.until(
            lambda: next((message for message in reversed(self.heard) if message.version == version), None),
            f"{version} is not heard",
        )
        return next(message for message in self.heard if message.version == found.version)

    def midstride(self, *words: str) -> str:
        command = [sys.executable, "-m", "midstride", *words]
        return subprocess.run(command, env=self.environment, capture_output=True, text=True, check=False).stdout

    @contextmanager
    def running(self) -> Iterator[subprocess.Popen[bytes]]:
        """`midstride dev`, up and heard; ended by Ctrl-C."""
        command = [sys.executable, "-m", "midstride", "dev", "dev_bench.stride", "--backend", "ros2"]
        with (
            recording("/counted", self._hear),
            (self.folder / "screen.txt").open("wb") as screen,
            subprocess.Popen(
                command,
                cwd=self.folder,
                env=self.environment,
                stdout=screen,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            ) as process,
        ):
            try:
                self.until(lambda: "Swapping on save" in self.screen() or process.poll() is not None, "it is not up")
                self.first("v0")
                yield process
            finally:
                process.send_signal(signal.SIGINT)
                process.wait(PATIENCE)

    def _hear(self, message: Any) -> None:
        version, number = message.data.split()
        self.heard.append(Heard(time.time(), version, int(number)))

    def gaps(self) -> list[str]:
        """Where a number is not the one before it and one."""
        pairs = zip(self.heard, self.heard[1:], strict=False)
        return [f"{a.version} {a.number}, then {b.version} {b.number}" for a, b in pairs if b.number != a.number + 1]


def measure(rate: float, saves: int) -> tuple[list[float], list[str]]:
    """The seconds from each save to the first message of the new code, and what was out of order."""
    with tempfile.TemporaryDirectory(prefix="ms") as folder:
        bench, latencies = Bench(Path(folder), rate), []
        with bench.running():
            for number in range(1, saves + 1):
                time.sleep(1.0)  # a person does not save more often
                saved = bench.save(bench.talker(f"v{number}"))
                latencies.append(bench.first(f"v{number}").at - saved)
            time.sleep(1.0)
        return latencies, bench.gaps()


def measure_faults(rate: float, saves: int) -> tuple[dict[str, list[float]], list[str]]:
    """The seconds from each save of faulty code to its traceback on the screen, and what was out of order."""
    with tempfile.TemporaryDirectory(prefix="ms") as folder:
        bench, latencies = Bench(Path(folder), rate), {fault: list[float]() for fault in RAISING}
        with bench.running():
            for number in range(saves):
                for fault in RAISING:
                    time.sleep(1.0)
                    latencies[fault].append(bench.refused(fault, number))
            time.sleep(1.0)
        return latencies, bench.gaps()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--saves", type=int, default=50)
    parser.add_argument("--faulty-saves", type=int, default=20, help="of each kind of fault")
    parser.add_argument("--rates", type=float, nargs="+", default=[10.0, 50.0], metavar="HZ")
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    guard()
    figures: list[dict[str, Any]] = []
    print(f"{'rate':>6} {'saves':>6} {'median':>8} {'longest':>8} {'out of order':>13}")
    for rate in arguments.rates:
        latencies, gaps = measure(rate, arguments.saves)
        median, longest = statistics.median(latencies), max(latencies)
        print(f"{rate:>3g} Hz {len(latencies):>6} {median:>6.2f} s {longest:>6.2f} s {len(gaps):>13}", flush=True)
        figures.append({"rate": rate, "latencies": latencies, "out_of_order": gaps})
    print(f"\n{'rate':>6} {'faulty saves':>31} {'median':>8} {'longest':>8} {'out of order':>13}")
    for rate in arguments.rates:
        refused, gaps = measure_faults(rate, arguments.faulty_saves)
        for fault, latencies in refused.items():
            median, longest, many = statistics.median(latencies), max(latencies), f"{len(latencies)} of {fault}"
            print(f"{rate:>3g} Hz {many:>34} {median:>6.2f} s {longest:>6.2f} s {len(gaps):>13}", flush=True)
        figures.append({"rate": rate, "refused": refused, "out_of_order": gaps})
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(figures, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
