"""`plan FILE --to NEW` and `apply NEW` with files in the language: each kind of difference, on running nodes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from tests.cli.conftest import Midstride, nothing_lost, running

SYSTEM = """system chain

contract Text = std_msgs/msg/String @ 50 Hz

topic /raw  : Text
topic /neat : Text

component Source {
  run "python3 source.py"
  parameters { changeable word = "one", unit = "m" }
  output out
  functionality make {
    produces out
    mode normal { guarantee out : Text }
    mode degraded { }
  }
}

component Pass {
  run "python3 pass.py passed"
  input  in : Text
  output out
  functionality pass {
    uses in
    produces out
    mode normal { assume in   guarantee out : Text }
    mode degraded { }
  }
}

component Other like Pass { run "python3 pass.py other" }

component Sink {
  run "python3 sink.py"
  input in : std_msgs/msg/String @ 10 Hz
  functionality use {
    uses in
    mode normal { assume in }
    mode degraded { }
  }
}

node source : Source { out -> /raw }
node pass   : Pass   { in <- /raw   out -> /neat }
node sink   : Sink   { in <- /neat }
"""

PROGRAMS = {
    "source.py": """
from midstride import Component
from std_msgs.msg import String

comp = Component("source")
out = comp.create_output("out", String)
word = comp.parameter("word", "", on_change=lambda value: None)
unit = comp.parameter("unit", "")
make = comp.create_functionality("make", outputs=[out])
make.set_normal_mode(lambda: out.write(String(data=f"{word.value} {unit.value}")), rate=50, outputs=[out])
make.set_degraded_mode(lambda: None)
comp.start()
""",
    "pass.py": """
import sys
from midstride import Component
from std_msgs.msg import String

comp = Component("pass")
inp, out = comp.create_input("in", String, rate=50), comp.create_output("out", String)
work = comp.create_functionality("pass", inputs=[inp], outputs=[out])
work.set_normal_mode(
    lambda message: out.write(String(data=f"{sys.argv[1]}: {message.data}")),
    inputs=[inp], outputs=[out], guarantees={out: 50},
)
work.set_degraded_mode(lambda: None)
comp.start()
""",
    "sink.py": """
from pathlib import Path
from midstride import Component
from std_msgs.msg import String

comp = Component("sink")
heard = Path(__file__).with_name("heard.txt").open("a", buffering=1)
last = [None]

def use(message):
    if message.data != last[0]:
        last[0] = message.data
        print(comp.instance, message.data, sep="\\t", file=heard)

inp = comp.create_input("in", String, rate=10)
work = comp.create_functionality("use", inputs=[inp])
work.set_normal_mode(use, inputs=[inp])
work.set_degraded_mode(lambda: None)
comp.start()
""",
}


@dataclass(frozen=True)
class Change:
    """What is written anew in SYSTEM; the plan's steps, without those that change modes; what ``by`` then hears.

    ``swapped``: whether a publisher is handed over, with nothing lost. ``more`` is written anew beside the first.
    """

    old: str
    new: str
    steps: tuple[str, ...]
    heard: str
    by: str = "sink"
    swapped: bool = False
    more: tuple[str, str] | None = None

    def made(self, text: str) -> str:
        for old, new in [(self.old, self.new), *([self.more] if self.more else [])]:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        return text


REPLACED = ("attach", "create", "detach", "handover", "remove")
CHANGES = {
    "a changeable parameter is set in place": Change('word = "one"', 'word = "two"', ("set",), "passed: two m"),
    "a parameter of another kind replaces the node": Change(
        'unit = "m"', 'unit = "km"', ("create", "handover", "remove"), "passed: one km", swapped=True
    ),
    "a node of another component is replaced": Change(
        "node pass   : Pass ", "node pass   : Other", REPLACED, "other: one m", swapped=True
    ),
    "another command replaces the node": Change(
        "pass.py passed", "pass.py past", REPLACED, "past: one m", swapped=True
    ),
    "a node more": Change(
        "node sink ", "node ear : Sink { in <- /raw }\nnode sink ", ("attach", "create"), "one m", "ear"
    ),
    "an input on another topic": Change("{ in <- /neat }", "{ in <- /raw }", ("attach", "detach"), "one m"),
    "a topic with another contract, and another publisher": Change(
        "topic /neat : Text",
        "topic /neat : std_msgs/msg/String @ 40 Hz",
        ("attach", "attach", "attach", "create", "detach", "detach", "detach", "remove"),
        "other: one m",
        more=("node pass   : Pass ", "node pass   : Other"),
    ),
    "a topic with another contract": Change(
        "topic /neat : Text",
        "topic /neat : std_msgs/msg/String @ 40 Hz",
        ("attach", "attach", "detach", "detach"),
        "passed: one m",
    ),
}


@dataclass
class Running:
    """The system, up, and the folder of its files."""

    midstride: Midstride
    folder: Path
    backend: str

    def file(self, text: str, name: str) -> str:
        path = self.folder / name
        path.write_text(text, encoding="utf-8")
        return str(path)

    def heard(self) -> list[tuple[str, str]]:
        """What came to the sinks, as (instance, words), each time it was other than before."""
        path = self.folder / "heard.txt"
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        return [(instance, words) for instance, words in (line.split("\t") for line in lines)]

    def roles(self) -> dict[str, set[str]]:
        """The roles that play, and the modes of each."""
        document = self.midstride("status", "--json").json
        assert document["valid"], document
        return {entry["role"]: {row["mode"] for row in entry["functionalities"]} for entry in document["instances"]}


BACKENDS = ["sim", pytest.param("ros2", marks=(pytest.mark.ros2, pytest.mark.full))]
# One of each kind of step, where each takes seconds.
ON_ROS_2 = (
    "a changeable parameter is set in place",
    "a parameter of another kind replaces the node",
    "an input on another topic",
    "a topic with another contract, and another publisher",
)


@pytest.fixture(scope="module")
def chains(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str], Running]]:
    """The system of SYSTEM, up on the back end that is asked for. It is started once for all tests of this module."""
    with ExitStack() as stack:

        @cache
        def chain_on(backend: str) -> Running:
            folder = tmp_path_factory.mktemp("chain")
            for name, text in PROGRAMS.items():
                (folder / name).write_text(text, encoding="utf-8")
            system = Running(stack.enter_context(contextmanager(running)()), folder, backend)
            up = system.midstride("up", system.file(SYSTEM, "chain.stride"), "--backend", backend, "--detach")
            assert up.status == 0, up.out + up.err
            return system

        yield chain_on


@pytest.fixture
def chain(request: pytest.FixtureRequest, chains: Callable[[str], Running]) -> Running:
    """Tests leave it as they found it."""
    return chains(request.param)


def structural(steps: list[dict[str, str]]) -> list[str]:
    return sorted(step["action"] for step in steps if step["action"] not in {"upgrade", "degrade"})


@pytest.mark.parametrize("chain", ["sim"], indirect=True)
@pytest.mark.parametrize("name", CHANGES)
def test_the_difference_of_two_files_is_applied(chain: Running, name: str) -> None:
    carry_out(chain, CHANGES[name])


@pytest.mark.ros2
@pytest.mark.parametrize("chain", ["ros2"], indirect=True)
@pytest.mark.parametrize("name", [ON_ROS_2[0], *(pytest.param(name, marks=pytest.mark.full) for name in ON_ROS_2[1:])])
def test_the_difference_of_two_files_is_applied_on_ros_2(chain: Running, name: str) -> None:
    carry_out(chain, CHANGES[name])


def carry_out(chain: Running, change: Change) -> None:
    """Apply a changed file, and then the original again."""
    midstride = chain.midstride
    old = chain.file(SYSTEM, "chain.stride")
    new = chain.file(change.made(SYSTEM), "new.stride")
    planned = midstride("plan", old, "--to", new, "--json")
    assert (planned.status, structural(planned.json["steps"])) == (0, sorted(change.steps))
    try:
        done = midstride("apply", new, "--yes", "--json")
        assert done.status == 0, done.out + done.err
        assert done.json["outcome"] == "done"
        assert structural(done.json["plan"]["steps"]) == sorted(change.steps)
        assert not any(done.json["below_baseline_seconds"].values()), done.json["below_baseline_seconds"]
        assert bool(done.json["swaps"]) == change.swapped
        assert not change.swapped or nothing_lost(done.json["swaps"], chain.backend)
        assert set().union(*chain.roles().values()) == {"normal"}
        deadline = time.monotonic() + 20
        while change.heard not in [words for by, words in chain.heard() if by == change.by][-1:]:
            assert time.monotonic() < deadline, chain.heard()
            time.sleep(0.02)
        assert midstride("apply", new, "--yes", "--json").json["plan"]["steps"] == []
    finally:
        back = midstride("apply", old, "--yes", "--json")
    assert back.status == 0, back.out + back.err
    assert chain.roles() == {"source": {"normal"}, "pass": {"normal"}, "sink": {"normal"}}


@pytest.mark.parametrize("chain", BACKENDS, indirect=True)
def test_removing_a_node_degrades_its_dependants(chain: Running) -> None:
    old = chain.file(SYSTEM, "chain.stride")
    new = chain.file(SYSTEM.replace("node pass   : Pass   { in <- /raw   out -> /neat }\n", ""), "new.stride")
    done = chain.midstride("apply", new, "--yes", "--json")
    assert done.status == 0, done.out + done.err
    assert structural(done.json["plan"]["steps"]) == ["detach", "detach", "remove"]
    assert chain.roles() == {"source": {"normal"}, "sink": {"degraded"}}
    assert chain.midstride("apply", old, "--yes").status == 0
    assert chain.roles() == {"source": {"normal"}, "pass": {"normal"}, "sink": {"normal"}}


@pytest.mark.parametrize("chain", ["sim"], indirect=True)
def test_an_invalid_file_changes_nothing(chain: Running) -> None:
    before = chain.midstride("status", "--json").json["instances"]
    new = chain.file(SYSTEM.replace("<- /neat", "<- /neet"), "new.stride")
    done = chain.midstride("apply", new, "--yes")
    assert (done.status, "did you mean `/neat`?" in done.err) == (1, True), done.err
    after = chain.midstride("status", "--json").json["instances"]
    assert [entry["pid"] for entry in after] == [entry["pid"] for entry in before]


@contextmanager
def edited(chain: Running, name: str, old: str, new: str) -> Iterator[Path]:
    """A program of the chain, saved with a change. Afterwards it is as it was, and runs so."""
    program = chain.folder / name
    before = program.read_text(encoding="utf-8")
    assert before.count(old) == 1
    program.write_text(before.replace(old, new), encoding="utf-8")
    try:
        yield program
    finally:
        program.write_text(before, encoding="utf-8")
        assert chain.midstride("apply", chain.file(SYSTEM, "chain.stride"), "--yes").status == 0


def until_heard(chain: Running, words: str) -> None:
    deadline = time.monotonic() + 20
    while words not in [said for _, said in chain.heard()][-1:]:
        assert time.monotonic() < deadline, chain.heard()
        time.sleep(0.02)


@pytest.mark.parametrize("chain", BACKENDS, indirect=True)
def test_an_edited_program_is_a_difference_that_apply_makes(chain: Running) -> None:
    midstride, file = chain.midstride, chain.file(SYSTEM, "chain.stride")
    assert midstride("diff", file).out == "No differences.\n"
    with edited(chain, "pass.py", "{sys.argv[1]}:", "{sys.argv[1]}, edited:") as program:
        status = midstride("status", "--json")
        assert status.status == 0  # it is as valid as it was
        changed = {entry["role"]: entry["changed_files"] for entry in status.json["instances"]}
        assert changed == {"source": [], "pass": [str(program)], "sink": []}
        assert f"code changed on disk: {program}; `midstride restart pass` deploys it" in midstride("status").out
        differing = midstride("diff", file)
        assert (differing.status, differing.out) == (1, f"node pass: replaced\n  code changed on disk: {program}\n")
        assert midstride("diff", file, "--keep-code").out == "No differences.\n"
        kept = midstride("apply", file, "--yes", "--keep-code", "--json").json
        assert (kept["outcome"], kept["plan"]["steps"]) == ("done", [])
        planned = midstride("apply", file, "--dry-run", "--json")
        assert (planned.status, [each["action"] for each in planned.json["steps"]][-1]) == (0, "remove")
        assert midstride("diff", file).status == 1, "a plan changes nothing"
        done = midstride("apply", file, "--yes")
        assert done.status == 0, done.out + done.err
        assert f"pass: code changed on disk: {program}" in done.out
        assert "hand over /neat" in done.out
        until_heard(chain, "passed, edited: one m")
        assert midstride("diff", file).out == "No differences.\n"


@pytest.mark.parametrize("chain", ["sim"], indirect=True)
def test_a_renamed_component_goes_on_under_its_new_name(chain: Running) -> None:
    midstride = chain.midstride
    before = midstride("status", "--json").json["instances"]
    new = chain.file(SYSTEM.replace("Pass", "Relay"), "new.stride")
    try:
        assert midstride("diff", new).out == "component Pass: renamed\n  to Relay; its nodes keep running\n"
        done = midstride("apply", new, "--yes")
        assert done.status == 0, done.err
        assert "component Pass is renamed Relay; its nodes keep running" in done.out
        after = midstride("status", "--json").json["instances"]
        assert [entry["pid"] for entry in after] == [entry["pid"] for entry in before]
        assert {entry["role"]: entry["component"] for entry in after}["pass"] == "Relay"
        assert midstride("status", "--json").json["file"] == midstride.saved("chain").file == new
        unchanged = chain.file(SYSTEM.replace("<- /neat", "<- /neet"), "refused.stride")
        assert midstride("apply", unchanged, "--yes").status == 1
        assert f"specification: {new}\n" in midstride("status").out
        assert midstride("restart", "pass", "--yes").status == 0, "which changes no specification"
        assert f"specification: {new}\n" in midstride("status").out
        assert midstride("remove", "sink", "--yes").status == 0
        assert f"specification: {new}, changed since (`midstride history`)\n" in midstride("status").out
        assert midstride.saved("chain").changed_since
    finally:
        assert midstride("apply", chain.file(SYSTEM, "chain.stride"), "--yes").status == 0
