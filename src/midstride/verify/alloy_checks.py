"""Checks the Alloy specification: every `check` and `run` must have the result that it states.

At small scopes start-up dominates, so the commands of a module share one process. At large scopes each command has its
own, several at a time as processors and memory allow.
"""

from __future__ import annotations

import os
import re
import tempfile
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any, Final

import psutil

from midstride.errors import AlloyFailed
from midstride.model.wording import counted
from midstride.verify import library
from midstride.verify.library import AlloyCommand
from midstride.verify.run import Alloy, SolverOutcome, fast_solver
from midstride.verify.verdict import Answer

# The heap of one process (MiB), and its default time limit (s).
MEMORY: Final = 2048
SECONDS: Final = 1800.0
SCOPES: Final = (3, 5)
_SMALL: Final = 3
_EXPECT: Final = re.compile(r"\s+expect [01]$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Task:
    """The commands that one process runs: one command, or all of a module."""

    module: str
    commands: tuple[AlloyCommand, ...]

    def __str__(self) -> str:
        return str(self.commands[0]) if len(self.commands) == 1 else self.module

    @property
    def pattern(self) -> str:
        """Alloy's pattern for these commands."""
        return self.commands[0].name if len(self.commands) == 1 else "*"


@dataclass(frozen=True, slots=True)
class Checked:
    """The result of a task. HOLDS: every command as expected; UNKNOWN: the Analyzer gave no answer."""

    task: Task
    answer: Answer
    seconds: float
    because: str | None = None

    @property
    def statement(self) -> str:
        """The statement that was checked."""
        if len(self.task.commands) > 1:
            checks = [command.scope for command in self.task.commands if command.kind == "check"]
            runs = len(self.task.commands) - len(checks)
            return f"{counted(len(checks), 'check')} to scope {max(checks, default=0)}, {counted(runs, 'run')}"
        (command,) = self.task.commands
        if command.kind == "run":
            return f"can happen, at scope {command.scope}"
        article = "a" if command.expected else "no"
        return f"has {article} counterexample, {'at' if command.expected else 'to'} scope {command.scope}"

    def to_document(self) -> dict[str, Any]:
        return {
            "check": str(self.task),
            "commands": [command.name for command in self.task.commands],
            "claim": self.statement,
            "verdict": self.answer.value,
            "because": self.because,
            "seconds": round(self.seconds, 3),
        }


def tasks(scope: int, modules: Sequence[str] | None = None) -> list[Task]:
    """All commands of the modules, those with the largest scope first, which take longest."""
    known = {module: tuple(library.commands(module, scope)) for module in modules or library.MODULES}
    if scope <= _SMALL:
        return [Task(module, commands) for module, commands in known.items()]
    single = [Task(module, (command,)) for module, commands in known.items() for command in commands]
    return sorted(single, key=lambda task: -task.commands[0].scope)


def parallel_jobs() -> int:
    """The number of processes for which this machine has processors and memory; at least one."""
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(processors, int(psutil.virtual_memory().available) // (MEMORY * 2**20)))


def check_specification(
    alloy: Alloy,
    scope: int = SCOPES[1],
    *,
    modules: Sequence[str] | None = None,
    texts: Mapping[str, str] | None = None,
    jobs: int | None = None,
    limit: float = SECONDS,
) -> Generator[Checked, None, None]:
    """Run every command of the specification, with checks to ``scope``; yields each task when it is done, in any order.

    ``limit`` bounds each task (s); ``texts`` replace modules, by name. Closing the generator stops its processes.
    """
    stop = Event()
    solver = "sat4j" if scope <= _SMALL else fast_solver(alloy)
    with tempfile.TemporaryDirectory(prefix="midstride-specification-") as folder:
        for module in library.MODULES:
            text = (texts or {}).get(module) or library.with_scope(module, scope)
            # The expectation is compared here: Alloy would stop without an answer where it is wrong.
            (Path(folder) / f"{module}.als").write_text(_EXPECT.sub("", text), encoding="utf-8")

        def solve(task: Task) -> dict[str, SolverOutcome]:
            source, quick = Path(folder) / f"{task.module}.als", scope <= _SMALL
            return alloy.solve(source, task.pattern, limit=limit, solver=solver, memory=MEMORY, quick=quick, stop=stop)

        with ThreadPoolExecutor(jobs or parallel_jobs()) as pool:
            waiting = [pool.submit(_checked, task, solve) for task in tasks(scope, modules)]
            try:
                for done in as_completed(waiting):
                    yield done.result()
            finally:
                stop.set()
                pool.shutdown(cancel_futures=True)


def _checked(task: Task, solve: Callable[[Task], dict[str, SolverOutcome]]) -> Checked:
    begun = time.monotonic()
    answer, because = Answer.HOLDS, None
    try:
        outcomes = solve(task)
    except AlloyFailed as error:
        answer, because = Answer.UNKNOWN, str(error)
    else:
        unanswered = [command.name for command in task.commands if command.name not in outcomes]
        wrong = [c for c in task.commands if c.name in outcomes and outcomes[c.name].satisfiable is not c.expected]
        if unanswered:
            answer, because = Answer.UNKNOWN, f"Alloy did not answer {', '.join(unanswered)}"
        elif wrong:
            answer, because = (
                Answer.VIOLATED,
                "; ".join(_mismatch(command, outcomes[command.name]) for command in wrong),
            )
    return Checked(task, answer, time.monotonic() - begun, because)


def _mismatch(command: AlloyCommand, outcome: SolverOutcome) -> str:
    """The difference between the result and the expectation."""
    if not outcome.satisfiable:
        missing = "a counterexample" if command.kind == "check" else "an instance"
        return f"{command} should have {missing} at scope {command.scope}, but has none"
    name = f"${command.name}_"
    bound = []
    for skolem, tuples in outcome.skolems.items():
        values = " + ".join(" -> ".join(atom.rpartition("/")[2] for atom in entry) for entry in tuples)
        bound.append(f"{skolem.removeprefix(name)} = {values or 'none'}")
    kind = "counterexample" if command.kind == "check" else "instance"
    return f"{command} should have no {kind}, but has one" + (f": {', '.join(bound)}" if bound else "")
