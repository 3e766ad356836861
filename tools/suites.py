"""suites.py MARKERS [--kilted] [--ros1] [--beside COMMAND;…] [-- ARGS…]: runs the tests, several suites at once.

- `computing`: in .venv, the tests in COMPUTING, at a lower priority, so that they delay no message;
- `waiting`: in .venv, all others;
- `kilted`: with the second ROS 2, of the tests in PLATFORM those of every day that are marked ros2;
- `gates`: with it as well, those in GATES, but not every day;
- `pages`: in .venv, where `kilted` and not only the tests of every day run, those in PAGES instead of `waiting`;
- `ros1`: with ROS 1, those marked ros1.

Of the tests of every day, all suites run at once. Else those that watch live ROS 2 systems in real time (`waiting`, and
beside it `kilted`, `gates` and `pages`, one after another) run after the others, with four tests at once on two
processors, which they use for less than half of the time: a process that gets no processor for longer than a period
misses it. Those marked long, many of which measure, run one suite after another; with `kilted` then also all others
that are marked ros2.

ARGS go to each pytest. The progress of each suite is shown as it comes, what it prints besides when it ends. A COMMAND,
such as a linter, runs beside them, and counts as a suite.

A test that computes and fails has failed. One of a live ROS system may have failed for want of a processor beside three
others: up to five of those run again when everything else has ended, alone, and must pass twice in a row. Those that
tests/quarantine.txt names must pass once of two times. The summary says which tests ran again. Nothing does if anything
else has failed. The last line is the total; the exit status is 1 if none passed or any failed.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import shlex
import signal
import subprocess
import sys
import threading
import time
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
QUARANTINE = ROOT / "tests" / "quarantine.txt"
# How often a test runs again, and of how many that are not in quarantine.
REPEATS = 2
MOST_AGAIN = 5
BESIDE_OTHERS = "it failed beside others, and had to pass twice alone"
# How long suites that are interrupted have to end (s).
GRACE = 5.0
# The tests that compute most of the time. The others wait, for processes and for messages.
COMPUTING = (
    *(f"tests/{name}" for name in "codec examples lang model node plan runtime simulation verify wire".split()),
    "tests/docs/test_site.py",
    *(f"tests/foreign/test_{name}_model.py" for name in "answers baton goals requests".split()),
    "tests/server/test_openapi_conformance.py",
)
# But these: they watch what processes do within fractions of a second.
TIMED = ("tests/runtime/test_process.py",)
# Of those that wait, what users are shown and given: about as many as make the two lists of suites equally long.
PAGES = ("tests/capture", "tests/cli/test_demo.py", "tests/docs", "tests/generate")
# What concerns a platform, on the second ROS 2: the back ends, and ...
PLATFORM = ("tests/backends", "tests/test_ground.py")
# ... in `make test-all` also what rests on the rcl, rclpy and middleware of a distribution: the gate in a C library,
# and the identity of publishers. `make test-long` runs all that is marked ros2 there.
_SWAPS = "tests/acceptance/test_foreign_swaps.py::test_a_node_"
GATES = (
    "tests/foreign",
    f"{_SWAPS}in_c_replaces_one_in_rclpy_and_the_other_way_round",
    f"{_SWAPS}hands_over_to_a_component_and_back",
)

_PROGRESS = re.compile(r"[.sFEx]+ +\[ *\d+%\]")
_PASSED, _SOME_FAILED, _NONE_CHOSEN = 0, 1, 5  # pytest's exit status
_printing = threading.Lock()


def say(line: str) -> None:
    with _printing:
        print(line, flush=True)


def quarantine(text: str) -> dict[str, str]:
    """The tests that may run again, each with the reason: a line with its id, and indented ones with what is known."""
    entries: dict[str, list[str]] = {}
    for line in text.splitlines():
        if line[:1].isspace() and line.strip():
            entries[next(reversed(entries))].append(line.strip())
        elif line and not line.startswith("#"):
            entries[line] = []
    return {test: " ".join(words) for test, words in entries.items()}


def computing_files() -> list[str]:
    folders_and_files = (sorted(path.rglob("test_*.py")) or [path] for path in (ROOT / each for each in COMPUTING))
    names = (str(file.relative_to(ROOT)) for files in folders_and_files for file in files)
    return [name for name in names if name not in TIMED]


@dataclass
class Suite:
    """A run of pytest in an environment of its own, or of another command."""

    name: str
    command: Sequence[str]
    arguments: Sequence[str] = ()
    workers: int = 1
    variables: dict[str, str] = field(default_factory=dict)
    live: bool = False  # of ROS systems, in real time
    watches: bool = False  # live ones of ROS 2
    status: int | None = None
    rounds: int = 0
    process: subprocess.Popen[str] | None = None

    def run(self, again: Collection[str] = ()) -> None:
        """Until it ends, prints its progress; then the rest of its output. Tests to run ``again`` run alone."""
        command = [*self.command]
        if self.arguments:
            command += ["python", "-m", "pytest", "-n", "1" if again else str(self.workers), "--dist", "worksteal"]
            command += ["-o", f"cache_dir={self._cache}", f"--junit-xml={self._report(self.rounds)}", *self.arguments]
        if again:
            self._last_failed.write_text(json.dumps(dict.fromkeys(again, True)), encoding="utf-8")
            command += ["--last-failed"]
        self.rounds += 1
        rest = []
        environment = {**os.environ, **self.variables}
        with subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
        ) as self.process:
            assert self.process.stdout is not None
            for line in self.process.stdout:
                if _PROGRESS.fullmatch(line.strip()):
                    say(f"{self.name:>9} {line.strip()}")
                else:
                    rest.append(line)
        self.status = self.process.returncode
        say(f"== {self.name}\n{''.join(rest).strip()}")

    @property
    def _cache(self) -> Path:
        return Path(os.environ["TMPDIR"]) / f"cache-{self.name}"

    def _report(self, number: int) -> Path:
        return Path(os.environ["TMPDIR"]) / f"{self.name}.{number}.xml"

    @property
    def _last_failed(self) -> Path:
        return self._cache / "v" / "cache" / "lastfailed"

    @property
    def has_passed(self) -> bool:
        return self.status == _PASSED or (bool(self.arguments) and self.status == _NONE_CHOSEN)

    def failed_tests(self) -> set[str]:
        """Empty where it is not tests that have failed."""
        file = self._last_failed
        return set(json.loads(file.read_bytes())) if self.status == _SOME_FAILED and file.exists() else set()

    def ends(self) -> Counter[str]:
        """How many tests passed, failed (or could not run) and were skipped. A test counts as in its last round."""
        ends: dict[tuple[str, str], str] = {}
        for report in filter(Path.exists, map(self._report, range(self.rounds))):
            tests: dict[tuple[str, str], str] = {}
            for case in ET.parse(report).getroot().iter("testcase"):
                test = (case.get("classname", ""), case.get("name", ""))
                found = {child.tag for child in case}
                end = "failed" if found & {"failure", "error"} else "skipped" if "skipped" in found else "passed"
                tests[test] = "failed" if tests.get(test) == "failed" else end
            ends |= tests
        return Counter(ends.values())


def suites(options: argparse.Namespace) -> list[Suite]:
    """The suites that have tests, where `options` name folders, files or tests."""
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 2
    half, more = max(1, processors // 2), processors * 3 // 2  # of what waits at times, more than there are processors
    tool = {name: str(ROOT / "tools" / name) for name in ("in-venv", "with-kilted", "with-ros1")}
    markers, daily = options.markers, "not full" in options.markers
    paths = [each for each in options.arguments if each.startswith("tests/")]
    given = [each for each in options.arguments if each not in paths]
    computing = [each for each in paths if each.startswith(COMPUTING) and not each.startswith(TIMED)]
    waiting = [each for each in paths if each not in computing]
    # Where ROS 1 is there, its tests have their own suite and environment; else they are skipped, and say so.
    first = ["-m", f"not ros1 and ({markers})" if options.ros1 else markers, *given]
    pages = PAGES if options.kilted and not (daily or paths or markers == "long") else ()
    found = []
    if waiting or not paths:
        chosen = waiting or [f"--ignore={each}" for each in (*computing_files(), *pages)]
        found.append(Suite("waiting", [tool["in-venv"]], [*first, *chosen], more, live=True, watches=True))
    if computing or not paths:
        niced = ["nice", "-n", "10", tool["in-venv"]]
        workers = processors if markers == "long" else more
        found.append(Suite("computing", niced, [*first, *(computing or computing_files())], workers))
    if options.kilted:
        second = partial(
            Suite,
            command=[tool["with-kilted"]],
            workers=half,
            variables={"MIDSTRIDE_NEEDS_ROS2": "1", "MIDSTRIDE_ROS2_ON_PATHS": "1"},
            live=True,
            watches=True,
        )
        if markers == "long":
            found.append(second("kilted", arguments=["-m", "ros2", *given, *paths]))
        elif daily or paths:
            found.append(second("kilted", arguments=["-m", f"ros2 and ({markers})", *given, *(paths or PLATFORM)]))
        else:
            every_day = f"ros2 and ({markers}) and not full"
            found.append(second("kilted", arguments=["-m", every_day, *given, *PLATFORM]))
            found.append(second("gates", arguments=["-m", f"ros2 and ({markers})", *given, *GATES]))
    if pages:
        kept = [f"--ignore={file}" for file in computing_files() if file.startswith(pages)]
        found.append(Suite("pages", [tool["in-venv"]], [*first, *pages, *kept], half, live=True, watches=True))
    if options.ros1:
        arguments = ["-m", f"ros1 and ({markers})", *given, *(paths or (PLATFORM if daily else ()))]
        workers = half if daily else processors
        found.append(Suite("ros1", [tool["with-ros1"]], arguments, workers, {"MIDSTRIDE_NEEDS_ROS1": "1"}, live=True))
    return found + [Suite(each.strip(), shlex.split(each)) for each in options.beside.split(";") if each.strip()]


def stages(chosen: Sequence[Suite], markers: str) -> list[list[list[Suite]]]:
    """What runs at once, and what after that: lists of suites that run one after another."""
    if markers == "long":
        return [[[suite]] for suite in chosen]
    if "not full" in markers:
        return [[[suite] for suite in chosen]]
    beside = [suite for suite in chosen if suite.watches and suite.name != "waiting"]
    watching = [[suite] for suite in chosen if suite.name == "waiting"] + ([beside] if beside else [])
    return [[[suite] for suite in chosen if not suite.watches], watching]


def run_all(lists: Sequence[Sequence[Suite]]) -> None:
    """Each suite of a list after the one before it, the lists at once."""
    interrupted = threading.Event()

    def run(several: Sequence[Suite]) -> None:
        for suite in several:
            if not interrupted.is_set():
                suite.run()

    threads = [threading.Thread(target=run, args=(several,), daemon=True) for several in lists]
    for thread in threads:
        thread.start()
    try:
        for thread in threads:
            thread.join()
    except BaseException:
        # A terminal interrupts them as well; each ends what it has started.
        interrupted.set()
        threads[0].join(GRACE)
        for suite in (suite for several in lists for suite in several):
            if suite.process is not None and suite.process.poll() is None:
                suite.process.send_signal(signal.SIGINT)
        for thread in threads:
            thread.join()
        raise


def run_again(chosen: Sequence[Suite]) -> list[str]:
    """Lines about the tests that ran again: none where anything failed that may not."""
    known = quarantine(QUARANTINE.read_text(encoding="utf-8"))
    failed = [(suite, suite.failed_tests()) for suite in chosen if not suite.has_passed]
    if not all(tests and (suite.live or tests <= known.keys()) for suite, tests in failed):
        return []
    if sum(len(tests - known.keys()) for _, tests in failed) > MOST_AGAIN:
        return []
    lines = []
    for suite, found in failed:
        statuses = []
        for tests, once_is_enough in ((found & known.keys(), True), (found - known.keys(), False)):
            if tests:
                say(f"== {suite.name}: tests that have failed run again, alone")
                for _ in range(REPEATS):
                    suite.run(tests)
                    if suite.has_passed is once_is_enough:
                        break
                statuses.append(suite.status)
                lines += [f"{suite.name}: {test} ({known.get(test, BESIDE_OTHERS)})" for test in sorted(tests)]
        suite.status = max(statuses, key=bool)
    return lines


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("markers")
    parser.add_argument("--kilted", action="store_true")
    parser.add_argument("--ros1", action="store_true")
    parser.add_argument("--beside", default="")
    cut = arguments.index("--")
    options = parser.parse_args(arguments[:cut])
    options.arguments = arguments[cut + 1 :]
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    begun = time.monotonic()
    chosen = suites(options)
    for stage in filter(None, stages(chosen, options.markers)):
        run_all(stage)
    again = [] if options.markers == "long" else run_again(chosen)  # these have run one suite after another
    for suite in chosen:
        say(f"== {suite.name}: {'passed' if suite.has_passed else f'failed ({suite.status})'}")
    for line in again:
        say(f"run again: {line}")
    ends: Counter[str] = sum((suite.ends() for suite in chosen), Counter())
    minutes, seconds = divmod(int(time.monotonic() - begun), 60)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    say(
        f"{ends['passed']} passed, {ends['failed']} failed, {ends['skipped']} skipped in {minutes} min {seconds} s"
        f" (processor time {used.ru_utime + used.ru_stime:.0f} s)"
    )
    return 0 if ends["passed"] and all(suite.has_passed for suite in chosen) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
