"""tools/mutation.py: how many small changes of the code, drawn from a seed, some test notices.

Each change (a *mutant*) is of one place in the body of a function or method of `model`, `plan`, `node`, `runtime` or
`wire`: a comparison, a condition, an operator, a number, a statement that is left out. Every place is as likely as
any other, so each package has its share. No file is changed: the tests are collected once, and for each mutant a
forked process exchanges the code of that function in memory and runs the tests that reach its lines, first those of
its package, the quickest first. The mutant is killed if one fails, or exceeds its time. Which tests reach which line
is recorded by running them once (in some minutes; kept in the folder .mutation until the source, or the file of the
test, changes). Survivors that are tried again (--again) have more time, and the tests marked `full` as well.

    tools/in-venv python tools/mutation.py --mutants 300 --seed 7    # exit status 1 below the score of --at-least

Mutants that change nothing that could be noticed are in tools/equivalent_mutants.json, each with the reason. One that
fits no place of today's code is reported, and makes the exit status 1. What this cannot mutate: defaults, constants and
class bodies, which are evaluated at import, and what only runs in other processes: those mutants count as survivors.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import copy
import gc
import hashlib
import importlib
import json
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import Any, Final

import pytest

ROOT: Final = Path(__file__).resolve().parent.parent
SOURCE: Final = ROOT / "src" / "midstride"
PACKAGES: Final = ("model", "plan", "node", "runtime", "wire")
# The tests that are asked: those of the packages, and of what is built on them and runs in the same process.
TESTS: Final = (*PACKAGES, "foreign", "server", "simulation", "backends")
MARKERS: Final = "not long and not ros1 and not ros2 and not alloy and not browser"
# Only survivors that are tried again are given to these as well.
QUICK: Final = f"not full and {MARKERS}"
EQUIVALENT: Final = ROOT / "tools" / "equivalent_mutants.json"
CACHE: Final = ROOT / ".mutation"
# How much processor time the tests of a mutant may take together as they were recorded (s): the rest is not run, unless
# the survivors of a run are tried again (--again), with so many times as much.
BUDGET, PATIENTLY = 10.0, 10.0
# A mutant has so many times the processor time that its tests took, and as much more (s): then it hangs.
FACTOR, MORE = 4.0, 10.0
# How much memory its process may have (bytes): one that never ends may collect without end.
MEMORY: Final = 3 * 2**30
# One that has used no processor time for so long waits for something that does not come (s).
LONGEST: Final = 60.0
SURVIVED, KILLED, IMPOSSIBLE, BROKEN = 0, 1, 3, 4

VERDICTS: Final = {SURVIVED: "survived", KILLED: "killed", IMPOSSIBLE: "impossible"}

Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True, order=True)
class Mutant:
    """``place``: the how manieth in its file. ``number`` tells equal changes in one function apart."""

    path: str
    place: int
    function: str = field(compare=False)
    first_line: int = field(compare=False)  # of the function, with its decorators
    line: int = field(compare=False)
    last_line: int = field(compare=False)
    before: str = field(compare=False)
    after: str = field(compare=False)
    number: int = field(compare=False)

    @property
    def key(self) -> str:
        again = f" #{self.number}" if self.number > 1 else ""
        return f"{self.path}::{self.function}: {self.before} -> {self.after}{again}"

    def __str__(self) -> str:
        return f"src/midstride/{self.path}:{self.line} {self.function}: {self.before} -> {self.after}"


# -- the mutants of a file --------------------------------------------------------------------------------

_COMPARISONS: Final[dict[type[ast.cmpop], type[ast.cmpop]]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
_OPERATORS: Final[dict[type[ast.operator], type[ast.operator]]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
_CALLED: Final = {"min": "max", "max": "min", "any": "all", "all": "any"}


def _changes(node: ast.AST) -> Iterator[ast.AST]:
    """What ``node`` may be replaced by."""
    match node:
        case ast.Compare(ops=[operator]) if type(operator) in _COMPARISONS:
            yield ast.Compare(node.left, [_COMPARISONS[type(operator)]()], node.comparators)
        case ast.BoolOp(op=operator):
            yield ast.BoolOp(ast.Or() if isinstance(operator, ast.And) else ast.And(), node.values)
        case ast.UnaryOp(op=ast.Not()):
            yield node.operand
        case ast.BinOp(op=operator) if type(operator) in _OPERATORS and not isinstance(node.left, ast.JoinedStr):
            yield ast.BinOp(node.left, _OPERATORS[type(operator)](), node.right)
        case ast.Constant(value=bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(value=int() | float() as value):
            yield ast.Constant(value + 1)
        case ast.Call(func=ast.Name(id=name)) if name in _CALLED:
            yield ast.Call(ast.Name(_CALLED[name], ast.Load()), node.args, node.keywords)
        case ast.If(test=test) | ast.IfExp(test=test) if not isinstance(test, (ast.Compare, ast.BoolOp, ast.UnaryOp)):
            changed = copy.copy(node)
            changed.test = ast.UnaryOp(ast.Not(), test)
            yield changed
        case ast.Return(value=value) if value is not None and not isinstance(value, ast.Constant):
            yield ast.Return(ast.Constant(None))
        case ast.Break():
            yield ast.Continue()
        case ast.Continue():
            yield ast.Break()
        case ast.Expr(value=ast.Call() | ast.Await()):
            yield ast.Pass()
        case ast.AugAssign() | ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
            yield ast.Pass()
        case ast.comprehension(ifs=[_, *_]):
            yield ast.comprehension(node.target, node.iter, [], node.is_async)


def _inside(node: ast.AST) -> Iterator[tuple[ast.AST, str, int | None, ast.AST]]:
    """Every node below ``node`` that runs with it: parent, field, index, and the node."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for index, each in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if isinstance(each, ast.AST) and not isinstance(each, (ast.Assert, ast.FormattedValue, ast.pattern)):
                yield node, name, index, each
                yield from _inside(each)


def _functions(tree: ast.AST, prefix: str = "") -> Iterator[tuple[str, Function]]:
    """The functions of a module and the methods of its classes, but not what is nested in them."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield prefix + node.name, node
        elif isinstance(node, ast.ClassDef):
            yield from _functions(node, f"{prefix}{node.name}.")
        elif isinstance(node, ast.If):
            yield from _functions(node, prefix)


def _lines(node: ast.AST, parent: ast.AST) -> tuple[int, int]:
    """The first and the last line on which a change of ``node`` shows."""
    where = node.test if isinstance(node, (ast.If, ast.IfExp)) else node if hasattr(node, "lineno") else parent
    assert isinstance(where, (ast.expr, ast.stmt))
    return where.lineno, where.end_lineno or where.lineno


def _shown(node: ast.AST, changed: ast.AST) -> tuple[str, str]:
    def text(each: ast.AST) -> str:
        if isinstance(each, (ast.If, ast.IfExp)):
            return f"if {ast.unparse(each.test)}"
        if isinstance(each, ast.comprehension):
            return ast.unparse(each).strip()
        return ast.unparse(each)

    return text(node), text(changed)


def _changed(tree: ast.Module, path: str) -> Iterator[tuple[Mutant, Callable[[], None]]]:
    """Each mutant of a file, and what makes it of ``tree``."""
    place = 0
    for name, function in _functions(tree):
        same: Counter[tuple[str, str]] = Counter()
        first = min([function.lineno, *(each.lineno for each in function.decorator_list)])
        body = ast.Module(function.body, [])
        for parent, attribute, index, node in _inside(body):
            for changed in _changes(node):
                shown = _shown(node, changed)
                same[shown] += 1
                lines = _lines(node, parent)
                mutant = Mutant(path, place, name, first, *lines, *shown, same[shown])
                place += 1
                yield mutant, partial(_put, parent, attribute, index, ast.copy_location(changed, node))


def _put(parent: ast.AST, attribute: str, index: int | None, node: ast.AST) -> None:
    ast.fix_missing_locations(node)
    if index is None:
        setattr(parent, attribute, node)
    else:
        getattr(parent, attribute)[index] = node


def _tree(path: str) -> ast.Module:
    return ast.parse((SOURCE / path).read_text(encoding="utf-8"))


def mutants_of(path: str) -> list[Mutant]:
    return [mutant for mutant, _ in _changed(_tree(path), path)]


def _mutated_code(mutant: Mutant) -> CodeType:
    tree = _tree(mutant.path)
    make = next(make for each, make in _changed(tree, mutant.path) if each == mutant)
    make()
    module = compile(tree, str(SOURCE / mutant.path), "exec", dont_inherit=True)
    name = mutant.function.rpartition(".")[2]
    return next(code for code in _codes(module) if (code.co_name, code.co_firstlineno) == (name, mutant.first_line))


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield from _codes(each)


def exchange(mutant: Mutant) -> bool:
    """Put the mutant in the place of the function in this process; whether there is such a function."""
    importlib.import_module("midstride." + mutant.path.removesuffix(".py").removesuffix("/__init__").replace("/", "."))
    code = _mutated_code(mutant)
    where = str(SOURCE / mutant.path), mutant.first_line, code.co_name
    gc.unfreeze()  # else they are not among the objects
    found = [
        each
        for each in gc.get_objects()
        if isinstance(each, FunctionType)
        and (each.__code__.co_filename, each.__code__.co_firstlineno, each.__code__.co_name) == where
    ]
    for each in found:
        each.__code__ = code
    gc.freeze()
    return bool(found)


# -- which tests reach which lines ------------------------------------------------------------------------

# By file of our packages, the lines that a test has reached, as the bits of a number.
Reached = dict[str, int]


@dataclass
class Recorded:
    """``tests``: the processor time of each (s). ``reached``: the lines of each."""

    tests: dict[str, float] = field(default_factory=dict)
    reached: dict[str, Reached] = field(default_factory=dict)

    def chosen(self, mutant: Mutant, budget: float) -> list[str]:
        """The tests that reach the lines of ``mutant``, in the order in which they are run, for ``budget`` seconds."""
        package = f"tests/{mutant.path.partition('/')[0]}/"
        module = Path(mutant.path).stem
        lines = (1 << mutant.last_line + 1) - (1 << mutant.line)
        reaching = [test for test, reached in self.reached.items() if reached.get(mutant.path, 0) & lines]

        def rank(test: str) -> tuple[int, float]:
            close = 0 if f"test_{module}" in test else 1 if test.startswith(package) else 2
            return close, self.tests[test]

        found, left = list[str](), budget
        for test in sorted(reaching, key=rank):
            if self.tests[test] <= left or not found:
                found.append(test)
                left -= self.tests[test]
        return found


class _Lines:
    """Notes the lines of our packages that are reached, on any thread, while it is in use."""

    def __init__(self) -> None:
        self.places: dict[CodeType, tuple[str, int] | None] = {}  # the file of each code, and all of its lines
        self.reached: Reached = {}

    def __call__(self, frame: FrameType, event: str, argument: object) -> Callable[..., Any] | None:
        code = frame.f_code
        try:
            place = self.places[code]
        except KeyError:
            place = self.places[code] = self._place(code)
        if place is None or not place[1] & ~self.reached.get(place[0], 0):
            return None  # there is nothing more to note
        name, reached = place[0], self.reached

        def note(frame: FrameType, event: str, argument: object) -> Callable[..., Any]:
            reached[name] = reached.get(name, 0) | 1 << frame.f_lineno
            return note

        return note(frame, event, argument)

    def _place(self, code: CodeType) -> tuple[str, int] | None:
        name = code.co_filename.removeprefix(f"{SOURCE}/")
        if name == code.co_filename or name.partition("/")[0] not in PACKAGES:
            return None
        return name, sum(1 << line for line in {line for *_, line in code.co_lines() if line is not None})


class _Reports:
    """Whether a test that this process runs has failed."""

    def __init__(self) -> None:
        self.failed = False

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.failed |= report.failed


class _Session:
    """A collection of tests, some of which forked processes run."""

    def __init__(self, work: Any, markers: str) -> None:
        self.work, self.markers = work, markers
        self.items: dict[str, pytest.Item] = {}
        self.error: BaseException | None = None

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self.config = session.config
        self.items = {item.nodeid: item for item in session.items}
        self.session = session
        gc.collect()
        gc.freeze()  # a collection in a forked process would copy all the memory that they share
        try:
            self.work(self)
        except BaseException as error:
            self.error = error
        return True

    def run(self, tests: list[str]) -> Iterator[tuple[str, bool, float]]:
        """Each of ``tests``, whether it has passed, and its processor time (s). Only in a forked process."""
        reports = _Reports()
        self.config.pluginmanager.unregister(name="terminalreporter")  # it writes to the terminal of the whole run
        self.config.pluginmanager.register(reports)
        for index, name in enumerate(tests):
            following = self.items[tests[index + 1]] if index + 1 < len(tests) else None
            reports.failed, begun = False, time.process_time()
            item = self.items[name]
            try:
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            except BaseException:  # what ends pytest as well: an interrupt, or an exit that a task has called for
                reports.failed = True
            yield name, not reports.failed, time.process_time() - begun


def collect(work: Any, markers: str = QUICK) -> None:
    session = _Session(work, markers)
    tests = [str(ROOT / "tests" / name) for name in TESTS if (ROOT / "tests" / name).exists()]
    options = ["-q", "-q", "-p", "no:cacheprovider", "--timeout=0"]
    os.chdir(ROOT)
    status = pytest.main([*options, "-m", markers, *tests], plugins=[session])
    if session.error is not None:
        raise session.error
    if not session.items:
        raise SystemExit(f"the tests could not be collected (pytest says {status})")


class Fork:
    """A process of its own, in a group and with a folder for its files."""

    def __init__(self, cpu: float | None, body: Any) -> None:
        """``cpu``: its limit (s); without one, it has all the time that it needs."""
        self.limited = cpu is not None
        self.used, self.since = -1.0, 0.0
        self.folder = tempfile.mkdtemp(prefix="m")
        self.pid = os.fork()
        if self.pid:
            return
        status = BROKEN
        try:
            os.setsid()
            tempfile.tempdir = os.environ["TMPDIR"] = self.folder
            silent = os.open(os.devnull, os.O_RDWR)
            for stream in (0, 1, 2):
                os.dup2(silent, stream)
            if cpu is not None:
                resource.setrlimit(resource.RLIMIT_CPU, (int(cpu), int(cpu) + 1))
                resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            status = body(Path(self.folder))
        finally:
            os._exit(status)

    def _waits(self) -> bool:
        """Whether it does nothing any more. How much time passes says nothing on a busy machine."""
        fields = Path(f"/proc/{self.pid}/stat").read_bytes().rpartition(b")")[2].split()  # its name may be no UTF-8
        used, now = sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK"), time.monotonic()
        if used > self.used:
            self.used, self.since = used, now
        return now - self.since > LONGEST

    def ended(self) -> int | None:
        """The exit status, negative for a signal; None while it runs."""
        pid, status = os.waitpid(self.pid, os.WNOHANG)
        if not pid and self.limited and self._waits():
            os.kill(self.pid, signal.SIGKILL)
            pid, status = os.waitpid(self.pid, 0)
        if not pid:
            return None
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        shutil.rmtree(self.folder, ignore_errors=True)
        return os.waitstatus_to_exitcode(status)


def _fresh_folder(session: _Session, folder: Path) -> None:
    factory = getattr(session.config, "_tmp_path_factory", None)
    if factory is not None:
        factory._given_basetemp, factory._basetemp = folder / "t", None


def _digest(paths: Iterable[Path], also: str = "") -> str:
    digest = hashlib.sha256(also.encode())
    for path in sorted(paths):
        digest.update(str(path).encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def record(session: _Session, jobs: int) -> Recorded:
    """Run each file of tests whose lines are not known for the source and the helpers of the tests as they are."""
    tests = set((ROOT / "tests").rglob("test_*.py"))
    common = _digest([*SOURCE.rglob("*.py"), *(set((ROOT / "tests").rglob("*.py")) - tests)])
    CACHE.mkdir(exist_ok=True)
    files = sorted({name.partition("::")[0] for name in session.items})
    kept = {file: CACHE / f"{common}-{_digest([ROOT / file], session.markers)}" for file in files}
    waiting, running, lost = [file for file in files if not kept[file].exists()], dict[Fork, str](), list[str]()
    random.Random(0).shuffle(waiting)
    total = len(waiting)
    while waiting or running:
        while waiting and len(running) < jobs:
            file = waiting.pop()
            names = [name for name in session.items if name.partition("::")[0] == file]
            fork = Fork(None, lambda folder, names=names, out=kept[file]: _record(session, names, folder, out))
            running[fork] = file
        time.sleep(0.05)
        for fork in list(running):
            if (status := fork.ended()) is None:
                continue
            file = running.pop(fork)
            print(f"\r{total - len(waiting) - len(running)} of {total} files recorded", end="", file=sys.stderr)
            if status != SURVIVED:
                lost.append(file)
    for old in CACHE.iterdir():
        if not old.name.startswith(common):
            old.unlink()
    found = Recorded()
    for path in filter(Path.exists, kept.values()):
        for line in path.read_text().splitlines():
            name, passed, cpu, reached = json.loads(line)
            if passed:
                found.tests[name] = cpu
                found.reached[name] = {file: int(bits, 16) for file, bits in reached.items()}
    print(
        f"\n{len(found.tests)} tests of {len(session.items)} passed; without result: {lost or 'none'}", file=sys.stderr
    )
    return found


def _record(session: _Session, tests: list[str], folder: Path, out: Path) -> int:
    _fresh_folder(session, folder)
    part = out.with_name(f"{out.name}.part")
    lines = _Lines()
    threading.settrace(lines)
    sys.settrace(lines)
    with part.open("w") as file:
        for name, passed, cpu in session.run(tests):
            bits = {path: f"{each:x}" for path, each in lines.reached.items()}
            file.write(json.dumps([name, passed, cpu, bits]) + "\n")
            lines.reached = {}
            sys.settrace(lines)
    part.rename(out)
    return 0


# -- the mutants ------------------------------------------------------------------------------------------


@dataclass
class Result:
    mutant: Mutant
    verdict: str  # of VERDICTS, or: timed out, uncalled, equivalent, broken
    by: str = ""


def _try(session: _Session, mutant: Mutant, tests: list[str], folder: Path) -> int:
    _fresh_folder(session, folder)
    try:
        if not exchange(mutant):
            return IMPOSSIBLE
    except (SyntaxError, ValueError):
        return IMPOSSIBLE
    for name, passed, _ in session.run(tests):
        if not passed:
            (folder / "by").write_text(name)
            return KILLED
    return SURVIVED


def judge(
    session: _Session, mutants: Iterable[Mutant], recorded: Recorded, jobs: int, budget: float
) -> Iterator[Result]:
    waiting, running = list(mutants)[::-1], dict[Fork, tuple[Mutant, list[str]]]()
    while waiting or running:
        while waiting and len(running) < jobs:
            mutant = waiting.pop()
            tests = recorded.chosen(mutant, budget)
            if not tests:
                yield Result(mutant, "uncalled")
                continue
            cpu = MORE + FACTOR * sum(recorded.tests[name] for name in tests)
            body = lambda folder, mutant=mutant, tests=tests: _try(session, mutant, tests, folder)  # noqa: E731
            running[Fork(cpu, body)] = mutant, tests
        time.sleep(0.05)
        for fork in list(running):
            noted = Path(fork.folder, "by")
            by = noted.read_text() if noted.exists() else ""
            if (status := fork.ended()) is None:
                continue
            mutant, tests = running.pop(fork)
            verdict = "timed out" if status < 0 else VERDICTS.get(status, "broken")
            yield Result(mutant, verdict, by)


def equivalents() -> dict[str, str]:
    found: dict[str, str] = json.loads(EQUIVALENT.read_text(encoding="utf-8")) if EQUIVALENT.exists() else {}
    return found


def _unnumbered(line: str) -> str:
    """A line of the output without the number of the line in the file, which changes most easily."""
    return re.sub(r"(\.py):\d+ ", r"\1 ", line, count=1)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--mutants", type=int, default=100, help="how many are drawn")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--skip", type=int, default=0, help="leave out so many of those drawn: they have been tried")
    parser.add_argument("--jobs", type=int, default=2, help="how many are tried at a time")
    parser.add_argument("--minutes", type=float, default=0.0, help="try no more after so long; 0: without limit")
    parser.add_argument("--only", default="", help="only those whose file and function contain this")
    parser.add_argument("--again", type=Path, help="instead of drawing: those that survived in this output of a run")
    parser.add_argument("--at-least", type=float, default=0.0, help="the score (%%) below which the exit status is 1")
    arguments = parser.parse_args()
    paths = sorted(str(each.relative_to(SOURCE)) for name in PACKAGES for each in (SOURCE / name).rglob("*.py"))
    everything = [mutant for path in paths for mutant in mutants_of(path)]
    known = equivalents()
    stale = sorted(set(known) - {mutant.key for mutant in everything})
    candidates = [mutant for mutant in everything if arguments.only in f"{mutant.path}::{mutant.function}"]
    drawn = random.Random(arguments.seed).sample(candidates, min(arguments.mutants, len(candidates)))[arguments.skip :]
    if arguments.again is not None:
        survived = {
            _unnumbered(line) for line in arguments.again.read_text().splitlines() if line.startswith("survived")
        }
        drawn = [mutant for mutant in everything if _unnumbered(f"survived   {mutant}") in survived]
    budget = BUDGET if arguments.again is None else BUDGET * PATIENTLY
    results: list[Result] = []
    begun = time.monotonic()

    def work(session: _Session) -> None:
        recorded = record(session, arguments.jobs)
        tried = [mutant for mutant in drawn if mutant.key not in known]
        results.extend(Result(mutant, "equivalent") for mutant in drawn if mutant.key in known)
        for result in judge(session, tried, recorded, arguments.jobs, budget):
            results.append(result)
            print(f"{result.verdict:<10} {result.mutant}{result.by and f'  [{result.by}]'}", flush=True)
            if arguments.minutes and time.monotonic() - begun > 60 * arguments.minutes:
                break

    collect(work, QUICK if arguments.again is None else MARKERS)
    counts = Counter(result.verdict for result in results)
    killed, lived = counts["killed"] + counts["timed out"], counts["survived"] + counts["uncalled"]
    score = 100 * killed / max(1, killed + lived)
    print(
        f"\n{len(results)} of {len(everything)} mutants (seed {arguments.seed}): {counts['killed']} killed,"
        f" {counts['timed out']} timed out, {counts['survived']} survived, {counts['uncalled']} in code that no test"
        f" calls, {counts['equivalent']} equivalent: {score:.1f} %"
    )
    for package in PACKAGES:
        of = Counter(result.verdict for result in results if result.mutant.path.startswith(f"{package}/"))
        print(f"  {package:<8} {of.total():>4}  " + ", ".join(f"{number} {verdict}" for verdict, number in of.items()))
    for key in stale:
        print(f"stale in {EQUIVALENT.name}: {key}")
    return int(bool(stale) or score < arguments.at_least)


if __name__ == "__main__":
    sys.exit(main())
