"""A manager of this version takes over a running system of an earlier one: no message is missed, and where it cannot,
nothing has ended.
"""

from __future__ import annotations

import itertools
import os
import re
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from midstride.foreign.page import GATES_FOLDER, PAGE
from midstride.foreign.page_layout import MAGIC, PageLayout
from midstride.foreign.page_layout import OLDEST as OLDEST_LAYOUT
from midstride.foreign.page_layout import VERSION as LAYOUT
from midstride.runtime.records import journal_records, state_store
from midstride.wire.frames import OLDEST, PROTOCOL
from tests.acceptance.foreign_support import declared_talker, programs_of_the_page
from tests.cli.conftest import EXAMPLES, ROOT, Midstride, alive
from tests.cli.earlier_version import TAKEN_OVER, TOO_EARLY, environment, installed

pytestmark = pytest.mark.ros2

TALKER = str(EXAMPLES / "talker" / "talker.stride")

# A node that knows nothing of Midstride: it writes each message that it hears to its output, a line each.
RECORDER = """
import sys
import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import String

rclpy.init()
node = rclpy.create_node("recorder")
node.create_subscription(String, sys.argv[1], lambda message: print(message.data, flush=True), QoSProfile(depth=1000))
rclpy.spin(node)
"""


class Recorder:
    """A process with the bare recorder of ``topic``."""

    def __init__(self, folder: Path, topic: str) -> None:
        self._path = folder / "recorded"
        with self._path.open("w") as output:
            self._process = subprocess.Popen([sys.executable, "-c", RECORDER, topic], stdout=output)

    def heard(self) -> list[str]:
        *lines, _ = self._path.read_text().split("\n")  # without one that is half written
        return lines

    def wait_for_more(self, count: int) -> None:
        """Wait until it has heard so many messages more."""
        enough = len(self.heard()) + count
        until(lambda: len(self.heard()) >= enough, "nothing is heard")

    def stop(self) -> list[str]:
        self._process.kill()
        self._process.wait()
        return self.heard()


def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)


@pytest.fixture(scope="module")
def earlier_site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return installed(TAKEN_OVER, tmp_path_factory.mktemp("earlier"))


@pytest.fixture
def earlier(midstride: Midstride, earlier_site: Path) -> Midstride:
    """The earlier version, with the systems of ``midstride``; each of its commands is a process."""
    return Midstride(midstride.runtime, environment(earlier_site))


def counter(folder: Path) -> str:
    """The talker of docs/how-to/state.md, which counts, and whose replacement goes on counting."""
    page = (ROOT / "docs" / "how-to" / "state.md").read_text(encoding="utf-8")
    for name, text in re.findall(r"```\w+ file=(counter\.\w+)\n(.*?)```", page, re.DOTALL):
        (folder / name).write_text(text, encoding="utf-8")
    return str(folder / "counter.stride")


@contextmanager
def recorded(folder: Path, topic: str) -> Iterator[Recorder]:
    recorder = Recorder(folder, topic)
    try:
        recorder.wait_for_more(1)
        yield recorder
    finally:
        recorder.stop()


@pytest.mark.full
def test_no_message_is_missed_while_a_manager_of_this_version_takes_over(
    midstride: Midstride, earlier: Midstride, tmp_path: Path
) -> None:
    specification = counter(tmp_path)
    up = earlier.process("up", specification, "-d")
    assert up.status == 0, up.err
    manager, components = midstride.manager("counter"), midstride.components("counter")
    refused = midstride("up", specification, "-d")
    assert refused.status == 1 and "of another version of Midstride, and `up --replace-manager` has" in refused.err
    with recorded(tmp_path, "/count") as recorder:
        taken = midstride("up", specification, "-d", "--replace-manager")
        assert taken.status == 0, taken.err
        assert (
            f"earlier version of Midstride, and speaks version {OLDEST} of the control protocol"
            in taken.err + taken.out
        )
        recorder.wait_for_more(10)
        assert midstride.manager("counter") != manager
        until(lambda: not alive(manager), "the earlier manager goes on")
        assert midstride.components("counter") == components and all(map(alive, components))
        # Its process is of the earlier version, its replacement's of this one: they hand over to each other.
        restarted = midstride("restart", "counter", "--yes", "--json", timeout=90)
        assert restarted.status == 0, restarted.out + restarted.err
        recorder.wait_for_more(10)
        numbers = [int(line) for line in recorder.stop()]
    assert numbers == list(range(numbers[0], numbers[-1] + 1)), "a number is missing, or came twice"
    assert not any(map(alive, components))
    commands = [change["command"] for change in midstride("history", "--json").json["changes"]]
    assert len(commands) == 2, "the changes of the earlier manager are in the history"


@pytest.mark.long
def test_a_node_without_the_api_is_taken_over_and_replaced(
    midstride: Midstride, earlier: Midstride, tmp_path: Path
) -> None:
    """The library in it, and the page, are of the earlier version; its replacement has the library of this one."""
    programs_of_the_page(tmp_path)
    talker = declared_talker("Plain", "python3 talker.py", "preload")
    head, node = "system gated\ntopic /chat : std_msgs/msg/String @ 50 Hz", "node talker : Plain { out -> /chat }"
    specification = tmp_path / "gated.stride"
    specification.write_text(f"{head}\n{talker}{node}\n", encoding="utf-8")
    up = earlier.process("up", str(specification), "-d")
    assert up.status == 0, up.err
    (page,) = (midstride.runtime / "midstride" / "gated" / "components" / GATES_FOLDER).glob(PAGE)
    assert PageLayout.from_buffer_copy(page.read_bytes()).version == OLDEST_LAYOUT < LAYOUT
    before = midstride.components("gated")
    with recorded(tmp_path, "/chat") as recorder:
        taken = midstride("up", str(specification), "-d", "--replace-manager")
        assert taken.status == 0, taken.err
        recorder.wait_for_more(10)
        assert midstride.components("gated") == before
        restarted = midstride("restart", "talker", "--yes", "--json", timeout=90)
        assert restarted.status == 0, restarted.out + restarted.err
        recorder.wait_for_more(10)
        said = [line.split()[0] for line in recorder.stop()]
    writers = [name for name, _ in itertools.groupby(said)]
    assert len(writers) == 2, f"both have written at a time, or one alone: {writers}"
    assert not any(map(alive, before))


def refused(midstride: Midstride, specification: str, *words: str) -> None:
    """A take-over is refused with these words, and nothing has ended."""
    system = Path(specification).stem
    manager, components = midstride.manager(system), midstride.components(system)
    taken = midstride("up", specification, "-d", "--replace-manager")
    assert taken.status == 1 and all(each in taken.err for each in words), taken.err
    assert midstride.manager(system) == manager and midstride.components(system) == components
    assert all(map(alive, [manager, *components]))


@pytest.mark.long
def test_what_this_version_cannot_manage_is_refused_before_anything_ends(midstride: Midstride) -> None:
    up = midstride("up", TALKER, "-d")
    assert up.status == 0, up.err
    workspace = midstride.runtime / "midstride" / "talker"

    def form(database: str, table: str, version: int) -> None:
        with closing(sqlite3.connect(workspace / database)) as connection, connection:
            connection.execute(f"UPDATE {table} SET value = ? WHERE key = 'version'", (str(version),))

    known = int(journal_records.VERSION)
    form("journal.db", "about", known + 1)
    refused(midstride, TALKER, f"a newer version of Midstride wrote it, in form {known + 1}", "use that version")
    form("journal.db", "about", known)
    other = {"ROS_DOMAIN_ID": str((int(os.environ["ROS_DOMAIN_ID"]) + 1) % 100)}
    refused(Midstride(midstride.runtime, other), TALKER, "so it would not reach them")
    gates = workspace / "components" / GATES_FOLDER
    gates.mkdir(exist_ok=True)
    (gates / PAGE).write_bytes(bytes(PageLayout(MAGIC, LAYOUT + 1)))
    refused(midstride, TALKER, f"has layout {LAYOUT + 1}, and this version uses {OLDEST_LAYOUT} to {LAYOUT}")
    (gates / PAGE).unlink()
    stopped = midstride.components("talker")[0]
    os.kill(stopped, signal.SIGSTOP)
    try:
        refused(midstride, TALKER, f"runs (process {stopped}), but does not answer on its control socket")
    finally:
        os.kill(stopped, signal.SIGCONT)
    # Last: it is read by the tests' own commands as well.
    manager = midstride.manager("talker")
    form("state.db", "system", state_store.VERSION + 1)
    taken = midstride("up", TALKER, "-d", "--replace-manager")
    assert taken.status == 1 and f"in form {state_store.VERSION + 1}, and this one reads" in taken.err
    assert midstride.manager("talker") == manager and midstride("status").status == 0
    form("state.db", "system", state_store.VERSION)
    taken = midstride("up", TALKER, "-d", "--replace-manager")
    assert taken.status == 0 and midstride.manager("talker") != manager, taken.err


@pytest.mark.long
def test_a_version_that_is_too_early_is_refused_and_goes_on(
    midstride: Midstride, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Each command says that the versions differ, and what to do."""
    too_early = Midstride(midstride.runtime, environment(installed(TOO_EARLY, tmp_path_factory.mktemp("too-early"))))
    up = too_early.process("up", TALKER, "-d")
    assert up.status == 0, up.err
    for words in (["status"], ["log"], ["lock", "--reason", "x"], ["plan", "--replace", "talker=NewTalker"]):
        done = midstride(*words)
        assert done.status == 1 and "another version of Midstride has started the manager" in done.err, done.err
        assert "`midstride up FILE --replace-manager`" in done.err
    spoken = f"this version of Midstride speaks {OLDEST} to {PROTOCOL}: an earlier version of Midstride has started it"
    refused(midstride, TALKER, "listener speaks version 7 of the control protocol", "talker speaks version 7", spoken)
    assert too_early.process("status").status == 0
    down = midstride("down")
    assert down.status == 0, down.err
    # What it has recorded is part of the history from then on.
    up = midstride("up", TALKER, "-d")
    assert up.status == 0 and "damaged" not in up.out + up.err, up.err
    assert [change["command"] for change in midstride("history", "--json").json["changes"]] == ["up", "up"]


@pytest.mark.long
def test_commands_of_both_versions_work_with_the_manager_of_the_other(midstride: Midstride, earlier: Midstride) -> None:
    for manager, client in ((earlier, midstride), (midstride, earlier)):
        up = manager.process("up", TALKER, "-d")
        assert up.status == 0, up.err
        for words in (
            ["status"],
            ["status", "--verbose"],
            ["history"],
            ["log"],
            ["logs", "talker"],
            ["why", "listener.listen"],
            ["export"],
            ["param", "list"],
            ["plan", "--replace", "talker=NewTalker"],
            ["diff", TALKER],
            ["lock", "--reason", "x"],
            ["unlock"],
            ["replace", "talker", "NewTalker", "--yes"],
            ["apply", TALKER, "--yes"],
            ["down"],
        ):
            done = client.process(*words, timeout=90)
            assert done.status == 0, (words, done.out, done.err)
