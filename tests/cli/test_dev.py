"""`midstride dev`: what it swaps on a save, and what it tries again; then the command itself, on the simulator."""

from __future__ import annotations

import py_compile
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import pytest
from msgspec import structs

from midstride.cli.client import Client
from midstride.cli.commands import dev
from midstride.cli.dev.contents import FileContents, saves
from midstride.cli.dev.session import DevSession
from midstride.cli.dev.watched_specification import WatchedSpecification
from midstride.codec.form import Document
from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.errors import SpecificationError
from midstride.model.specification import Specification
from midstride.runtime.records.reports import Outcome
from midstride.runtime.records.status_forms import ProgramStatus
from tests.cli.conftest import EXAMPLES, Midstride, alive
from tests.cli.terminal import Terminal
from tests.cli.test_other_overlay import overlay


@dataclass
class Robot:
    """A manager of the talker's example that runs what the files were when it was asked last, and the screen.

    It refuses what has a file with the word ``bad`` in it.
    """

    folder: Path
    requests: list[Document] = field(default_factory=list)
    shown: list[str] = field(default_factory=list)
    more_files: dict[str, list[str]] = field(default_factory=dict)
    rolling_back: bool = False  # the new instance of the talker still runs

    def __post_init__(self) -> None:
        for file in ("talker.py", "new_talker.py", "listener.py", "talker.stride"):
            (self.folder / file).write_text((EXAMPLES / "talker" / file).read_text())
        specification = WatchedSpecification(self.folder / "talker.stride")
        self.runs = specification.wanted
        self.code = {role: self._texts(role) for role in ("talker", "listener")}
        self.session = DevSession(specification, cast(Client, self), self.carry_out, self, interval=0.0)

    def edit(self, file: str, old: str, new: str) -> None:
        path = self.folder / file
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))
        self.session.look()

    # -- the manager -----------------------------------------------------------------------------------

    def _files(self, role: str) -> list[str]:
        return [str(self.folder / f"{role}.py"), *self.more_files.get(role, [])]

    def _texts(self, role: str) -> dict[str, str]:
        return {path: Path(path).read_text() for path in self._files(role) if Path(path).exists()}

    def specification(self) -> Specification:
        return self.runs

    def programs(self) -> list[ProgramStatus]:
        programs = [
            ProgramStatus(
                name=role,
                role=role,
                files=self._files(role),
                changed=[path for path, text in self._texts(role).items() if self.code[role].get(path) != text],
                unknown=None,
                startable=True,
            )
            for role in self.code
        ]
        if self.rolling_back:
            programs.append(structs.replace(programs[0], name="talker_2", changed=[]))
        return programs

    def carry_out(self, request: Document, finished: Callable[[Outcome], None]) -> str | None:
        self.requests.append({**request, "to": "to" in request})
        texts = [text for role in request["restart"] for text in self._texts(role).values()]
        if "to" in request:
            texts += [(self.folder / "new_talker.py").read_text()]
        if any("bad" in text for text in texts):
            return "it is bad"
        self.code |= {role: self._texts(role) for role in request["restart"]}
        if "to" in request:
            self.runs = decode_specification(request["to"])
        finished(Outcome(outcome="done"))
        return None

    def asked(self) -> list[Document]:
        """The requests since the last call."""
        asked, self.requests = self.requests, []
        return asked

    # -- the screen ------------------------------------------------------------------------------------

    def swapped(self, what: str, outcome: Outcome) -> None:
        self.shown.append(f"swapped {what}")

    def refused(self, what: str, because: str) -> None:
        self.shown.append(f"refused {what}: {because}")

    def faulty(self, error: SpecificationError) -> None:
        self.shown.append(f"faulty: {error.problems[0]}")


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    robot = Robot(tmp_path)
    for _ in range(2):  # the second time, it knows the programs' files
        robot.session.look()
    assert (robot.asked(), robot.shown) == ([], [])
    return robot


def restart(*roles: str, to: bool = False) -> Document:
    return {"restart": list(roles), "to": to}


def test_a_save_swaps_the_node_whose_code_it_changes(robot: Robot) -> None:
    robot.edit("talker.py", "hello", "hallo")
    assert robot.asked() == [restart("talker")]
    assert robot.shown == ["swapped talker (talker.py)"]
    robot.session.look()
    (robot.folder / "talker.py").touch()  # saved again, with the same content
    robot.session.look()
    (robot.folder / "new_talker.py").write_text("# no node runs this")
    robot.session.look()
    assert robot.asked() == []


def test_a_module_that_two_nodes_import_swaps_both_at_once(robot: Robot) -> None:
    shared = robot.folder / "shared.py"
    shared.write_text("word = 1")
    robot.more_files = {"talker": [str(shared)], "listener": [str(shared)]}
    robot.code = {role: robot._texts(role) for role in robot.code}
    for _ in range(2):
        robot.session.look()
    robot.edit("shared.py", "1", "2")
    assert robot.asked() == [restart("listener", "talker")]
    assert robot.shown == ["swapped listener (shared.py), talker (shared.py)"]


def test_what_changed_outside_before_it_attached_is_named_and_swapped_and_another_overlay_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Any
) -> None:
    """The module behind a package's executable is none of the files of the specification."""
    one, other = overlay(tmp_path / "one", "talk"), overlay(tmp_path / "other", "talk")
    installed = one / "lib" / "demo" / "talk"
    module = tmp_path / "site" / "demo_nodes" / "talk.py"
    module.parent.mkdir(parents=True)
    module.write_text("word = 1")
    robot = Robot(tmp_path)
    robot.more_files = {"talker": [str(module), str(installed)]}
    robot.code["talker"] = robot._texts("talker")
    module.write_text("word = 2")

    class Attached:
        """The client of a manager that runs already."""

        answers = staticmethod(lambda: True)
        specification = staticmethod(lambda: robot.runs)

        def __init__(self, *_: object, with_other_nodes: bool = False) -> None:
            assert not with_other_nodes
            self.carry_out = robot.carry_out  # instead of the requests of `Changes`

        def programs(self) -> list[ProgramStatus]:
            talker, *others = robot.programs()
            return [structs.replace(talker, executable=str(installed)), *others]

    monkeypatch.setenv("XDG_RUNTIME_DIR", tempfile.gettempdir())
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{other}:{one}")
    monkeypatch.setattr(dev, "Client", Attached)
    monkeypatch.setattr(dev, "Changes", Attached)
    monkeypatch.setattr(dev, "saves", lambda _: iter(()))
    status, out, err = run("dev", tmp_path / "talker.stride")
    assert (status, err) == (0, "")
    assert robot.asked() == [restart("talker")]
    shown = " ".join(out.split())
    assert f"talker ({module.name}): swapped in" in shown
    assert f"talker: `talk` of package demo is {other}/lib/demo/talk in this shell, and {installed} for the" in shown


def test_python_cannot_run_what_it_has_compiled_before_the_save(robot: Robot) -> None:
    """It would, where the size and the second are the same."""
    helper = robot.folder / "helper.py"
    helper.write_text("word = 1")
    robot.more_files = {"talker": [str(helper)]}
    robot.code["talker"] = robot._texts("talker")
    robot.session.look()
    compiled = Path(py_compile.compile(str(helper)) or "")
    assert compiled.exists()
    robot.edit("helper.py", "1", "2")
    assert robot.asked() == [restart("talker")]
    assert not compiled.exists()


def test_what_was_refused_is_tried_again_when_its_files_change_and_not_before(robot: Robot) -> None:
    robot.edit("talker.py", "hello", "bad")
    assert robot.asked() == [restart("talker")]
    assert robot.shown == ["refused talker (talker.py): it is bad"]
    robot.edit("listener.py", "I heard", "I have heard")  # another node's file
    assert robot.asked() == [restart("listener")]
    robot.edit("talker.py", "bad", "good")
    assert robot.asked() == [restart("talker")]
    assert robot.shown[-1] == "swapped talker (talker.py)"


def test_what_was_refused_is_not_tried_again_for_its_instance_that_is_rolled_back(robot: Robot) -> None:
    """That one runs the code of the file: where this is looked at, there is no change."""
    robot.edit("talker.py", "hello", "bad")
    robot.rolling_back = True
    robot.session.look()
    robot.rolling_back = False
    robot.session.look()
    assert robot.asked() == [restart("talker")]


def test_a_node_that_has_crashed_is_restarted_with_the_next_save_and_not_before(robot: Robot) -> None:
    robot.edit("talker.py", "hello", "crashing")
    assert robot.asked() == [restart("talker")]
    del robot.code["talker"]
    for _ in range(3):
        robot.session.look()
    assert robot.asked() == []
    robot.edit("talker.py", "crashing", "bad")
    assert robot.asked() == [restart("talker")]
    robot.edit("talker.py", "bad", "hello again")
    assert robot.asked() == [restart("talker")] and robot.shown[-1] == "swapped talker (talker.py)"
    robot.session.look()
    assert robot.asked() == []


def test_a_save_between_a_crash_and_its_discovery_is_not_lost(robot: Robot) -> None:
    del robot.code["talker"]
    robot.edit("talker.py", "hello", "hello again")
    assert robot.asked() == [restart("talker")]


def test_a_node_that_was_removed_elsewhere_is_not_restarted(robot: Robot) -> None:
    del robot.code["talker"]
    robot.runs = robot.runs.without_node("talker")
    robot.edit("talker.py", "hello", "hello again")
    assert robot.asked() == []


def test_code_that_is_undone_after_it_was_refused_needs_nothing(robot: Robot) -> None:
    robot.edit("talker.py", "hello", "bad")
    robot.asked()
    robot.edit("talker.py", "bad", "hello")
    assert robot.asked() == []
    robot.edit("talker.py", "hello", "bad")
    assert robot.asked() == [restart("talker")]


def test_a_module_that_new_code_needs_is_waited_for(robot: Robot) -> None:
    robot.edit("talker.py", "hello", "bad: imports what is not there yet")
    robot.asked()
    (robot.folder / "helper.py").write_text("word = 1")
    robot.session.look()
    assert robot.asked() == [restart("talker")]


def test_a_swap_after_which_code_still_counts_as_changed_is_not_repeated(robot: Robot) -> None:
    """A program may write a module when it starts: the manager cannot know what it has read."""
    finished: list[Document] = []

    def carry_out(request: Document, done: Callable[[Outcome], None]) -> str | None:
        finished.append(request)
        return None  # and what runs differs from the file as before

    robot.session.carry_out = carry_out
    robot.edit("talker.py", "hello", "hallo")
    for _ in range(3):
        robot.session.look()
    assert len(finished) == 1
    robot.edit("talker.py", "hallo", "hullo")
    assert len(finished) == 2


def test_a_save_while_a_new_version_is_watched_replaces_it_at_once(robot: Robot) -> None:
    """The old version and the new one run. What becomes of a change is known later."""
    ends: list[Callable[[Outcome], None]] = []

    def carry_out(request: Document, done: Callable[[Outcome], None]) -> str | None:
        robot.requests.append({**request, "to": "to" in request})
        ends.append(done)
        return None

    robot.session.carry_out = carry_out
    robot.edit("talker.py", "hello", "hallo")
    robot.rolling_back = True
    robot.session.look()
    assert robot.asked() == [restart("talker")]
    robot.edit("talker.py", "hallo", "hullo")
    robot.session.look()
    assert robot.asked() == [restart("talker")]
    ends[0](Outcome(outcome="done"))
    ends[1](Outcome(outcome="rolled_back", because="it does not keep its rate"))
    assert robot.shown == ["swapped talker (talker.py)", "refused talker (talker.py): it does not keep its rate"]
    robot.rolling_back = False
    robot.session.look()
    assert robot.asked() == []


def test_a_faulty_node_does_not_keep_the_others_out(robot: Robot) -> None:
    (robot.folder / "listener.py").write_text("better")
    robot.edit("talker.py", "hello", "bad")
    assert robot.asked() == [restart("listener", "talker"), restart("listener"), restart("talker")]
    assert robot.shown[1:] == ["swapped listener (listener.py)", "refused talker (talker.py): it is bad"]


def test_a_faulty_specification_is_shown_and_the_system_goes_on(robot: Robot) -> None:
    robot.edit("talker.stride", "10 Hz", "10 Hzz")
    assert robot.asked() == []
    assert len(robot.shown) == 1 and "Hzz" in robot.shown[0]
    robot.edit("talker.py", "hello", "hallo")  # meanwhile, code is swapped as before
    assert robot.asked() == [restart("talker")]
    robot.edit("talker.stride", "10 Hzz", "20 Hz")
    assert robot.asked() == [restart(to=True)]
    assert robot.shown[-1] == "swapped talker.stride"


def test_a_save_while_the_specification_is_read_is_not_lost(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    specification = robot.session.specification
    read, path = specification.read, robot.folder / "talker.stride"

    def saved_meanwhile() -> Any:
        found = read()
        path.write_text(path.read_text().replace("20 Hz", "25 Hz"))
        return found

    monkeypatch.setattr(specification, "read", saved_meanwhile)
    robot.edit("talker.stride", "10 Hz", "20 Hz")
    robot.session.look()
    assert "25" in str(encode_specification(robot.runs)["topics"])


def test_a_specification_that_was_refused_is_tried_again_when_a_program_of_it_changes(robot: Robot) -> None:
    (robot.folder / "new_talker.py").write_text("bad")
    robot.edit("talker.stride", "node talker   : Talker ", "node talker   : NewTalker")
    assert robot.asked() == [restart(to=True)]
    robot.session.look()
    assert robot.asked() == []
    robot.edit("new_talker.py", "bad", "good")
    assert robot.asked() == [restart(to=True)]
    assert robot.shown == ["refused talker.stride: it is bad", "swapped talker.stride"]


def test_a_change_from_elsewhere_is_not_taken_back_by_a_save(robot: Robot) -> None:
    robot.runs = robot.runs.with_replaced("talker", "NewTalker")
    robot.edit("listener.py", "I heard", "I have heard")
    assert robot.asked() == [restart("listener")]


def test_an_included_file_and_a_parameter_file_are_watched(tmp_path: Path) -> None:
    (tmp_path / "parts.stride").write_text(
        (EXAMPLES / "talker" / "talker.stride").read_text().replace("system talker\n", "")
    )
    (tmp_path / "talker.stride").write_text('system talker\n\ninclude "parts.stride"\n')
    specification = WatchedSpecification(tmp_path / "talker.stride")
    assert set(specification.files) == {str(tmp_path / name) for name in ("talker.stride", "parts.stride")}
    assert str(tmp_path / "new_talker.py") in set(specification.programs())
    (tmp_path / "parts.stride").write_text("nonsense")
    with pytest.raises(SpecificationError):
        specification.read()
    assert str(tmp_path / "parts.stride") in specification.files  # where the fault is


def test_a_file_that_is_being_replaced_is_not_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, contents = tmp_path / "talker.py", FileContents()
    path.write_text("hello")
    before = contents.of([str(path)])
    path.unlink()
    monkeypatch.setattr(time, "sleep", lambda _: path.write_text("hello"))
    assert contents.of([str(path)]) == before
    monkeypatch.setattr(time, "sleep", lambda _: path.unlink(missing_ok=True))
    path.unlink()
    assert contents.of([str(path)]) == {str(path): None}


def test_a_save_wakes_it_in_each_folder(tmp_path: Path) -> None:
    folders = {str(tmp_path)}
    other = tmp_path / "other"
    other.mkdir()
    woken = saves(lambda: frozenset(folders))

    def wakes_on(path: Path) -> None:
        stop = threading.Event()

        def write() -> None:
            while not stop.wait(0.02):
                path.write_text(str(time.monotonic()))

        with_writer = threading.Thread(target=write)
        with_writer.start()
        try:
            begun = time.monotonic()
            next(woken)
            assert time.monotonic() - begun < 60
        finally:
            stop.set()
            with_writer.join()

    wakes_on(tmp_path / "talker.py")
    folders.add(str(other))
    wakes_on(other / "helper.py")


# -- the command -------------------------------------------------------------------------------------------


@pytest.fixture
def project(tmp_path: Path) -> Path:
    for file in (EXAMPLES / "talker").iterdir():
        if file.suffix in {".py", ".stride"}:
            (tmp_path / file.name).write_text(file.read_text().replace("10 Hz", "50 Hz").replace("rate=10", "rate=50"))
    return tmp_path


def write(path: Path, old: str, new: str) -> None:
    """Save as many editors do, by a rename."""
    text = path.read_text()
    assert old in text
    beside = path.with_suffix(".tmp")
    beside.write_text(text.replace(old, new))
    beside.replace(path)


def test_dev_swaps_what_is_saved_and_refuses_what_is_faulty(midstride: Midstride, project: Path) -> None:
    file = str(project / "talker.stride")
    refused = midstride("dev", file, "--backend", "sim", "--use-sim-time")
    assert (refused.status, "--use-sim-time is for ROS 2" in refused.err) == (2, True)
    with Terminal(midstride, "dev", file, "--backend", "sim", "--no-middleware-settings") as terminal:
        terminal.until("Swapping on save; Ctrl-C stops the system.")
        assert not midstride.saved("talker").options.middleware_settings
        write(project / "talker.py", "hello world", "hello new world")
        shown = terminal.until(", missed ")  # in real time: how many depends on the machine
        assert "talker (talker.py): swapped in" in shown
        write(project / "talker.py", "def normal()", "def normal(")
        shown = terminal.until("SyntaxError")
        assert "talker (talker.py): rejected; the old code keeps running" in shown
        write(project / "talker.stride", "50 Hz", "5O Hz")
        terminal.until("is not a valid unit for a rate")
        write(project / "talker.stride", "5O Hz", "50 Hz")
        write(project / "talker.stride", "python3 talker.py", "python3 new_talker.py")
        terminal.until("talker.stride: swapped in")
        components = midstride("status", "--json").json["instances"]
        assert [entry["name"] for entry in components] == ["listener", "talker_3"]
        manager = midstride.manager("talker")
        terminal.press("\x03")
        assert "Stopping talker" in terminal.rest()
        assert terminal.status == 0
    deadline = time.monotonic() + 20
    while alive(manager):
        assert time.monotonic() < deadline, "the manager does not end"
        time.sleep(0.02)


@pytest.mark.full
def test_dev_stops_its_system_when_the_terminal_is_closed(midstride: Midstride, project: Path) -> None:
    with Terminal(midstride, "dev", str(project / "talker.stride"), "--backend", "sim") as terminal:
        terminal.until("Swapping on save; Ctrl-C stops the system.")
        manager = midstride.manager("talker")
        terminal.close()
        deadline = time.monotonic() + 40
        while alive(manager):
            assert time.monotonic() < deadline, "the manager does not end"
            time.sleep(0.02)
    assert "no system is running" in midstride("status").err


@pytest.mark.full
def test_dev_attaches_to_a_running_system_and_leaves_it_running(midstride: Midstride, project: Path) -> None:
    file = str(project / "talker.stride")
    assert midstride("up", file, "--backend", "sim", "-d").status == 0
    write(project / "talker.py", "hello world", "hello new world")  # before it attaches
    with Terminal(midstride, "dev", file, "--no-middleware-settings") as terminal:
        terminal.until("talker is running already: --use-sim-time and --no-… have no effect")
        terminal.until("Swapping on save; Ctrl-C leaves it running.")
        terminal.until("talker (talker.py): swapped in")
        terminal.press("\x03")
        terminal.rest()
        assert terminal.status == 0
    status = midstride("status", "--json").json
    assert [entry["changed_files"] for entry in status["instances"]] == [[], []]
