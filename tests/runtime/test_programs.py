"""Fingerprints: which files a program has, as it read them, and which have changed (docs/protocols/programs.md)."""

from __future__ import annotations

import asyncio
import importlib.util
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import replace as changed
from pathlib import Path
from types import ModuleType

import pytest

from midstride.backends.simulator import Simulator
from midstride.errors import PlanRefused
from midstride.node import loaded_program as node_program
from midstride.node.loaded_program import ProgramFiles, process_started
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.status_forms import ProgramStatus
from midstride.runtime.workspace import Workspace
from midstride.wire import program as wire_program
from midstride.wire.program import FileFingerprint, files_named
from tests.process_name import named
from tests.runtime.systems import EXAMPLES, example, managed, stateful_talkers

# Later than any file of a test was written: its process has read the files as they are.
LATER = time.time_ns() + 10**15


def kept(path: Path, text: str) -> None:
    """Write ``text`` without changing the time of modification."""
    times = path.stat()
    path.write_text(text)
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


def read(path: Path, started: int = LATER) -> FileFingerprint:
    file = FileFingerprint.read(str(path), started)
    assert file is not None
    return file


def test_a_file_has_changed_when_its_content_has(tmp_path: Path) -> None:
    script = tmp_path / "talker.py"
    script.write_text("hello")
    file = read(script)
    assert file.unchanged()
    os.utime(script, ns=(1, 1))  # touched: another time, the same content
    assert file.unchanged()
    script.write_text("hallo")
    assert file.unchanged() is None
    script.write_text("hello")  # undone
    assert file.unchanged()
    script.unlink()
    assert file.unchanged() is None


def test_what_was_modified_after_the_process_had_started_may_not_be_what_it_has_read(tmp_path: Path) -> None:
    script = tmp_path / "talker.py"
    script.write_text("hello")
    assert read(script, started=script.stat().st_mtime_ns - 1).unchanged() is None
    assert read(script, started=script.stat().st_mtime_ns).unchanged()


def test_a_time_of_modification_to_come_says_nothing(tmp_path: Path) -> None:
    script = tmp_path / "talker.py"
    script.write_text("hello")
    os.utime(script, ns=(LATER, LATER))
    assert read(script, started=1).unchanged()


def test_a_large_file_is_compared_without_being_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wire_program, "LARGEST_HASHED", 4)
    library = tmp_path / "library.so"
    library.write_text("hello")
    file = read(library)
    assert file.digest is None
    assert file.unchanged()
    os.utime(library, ns=(1, 1))
    assert file.unchanged() is None


def test_only_regular_files_are_files_of_a_program(tmp_path: Path) -> None:
    assert FileFingerprint.read(str(tmp_path), LATER) is None
    assert FileFingerprint.read(str(tmp_path / "none"), LATER) is None


def test_the_files_that_a_command_names(tmp_path: Path) -> None:
    (tmp_path / "start").touch(mode=0o755)
    (tmp_path / "rows.csv").touch()
    words = ["./start", "node.py", "--config=a/b.yaml", "rows.csv", "bash", "-v"]
    assert list(files_named(words, str(tmp_path))) == [
        str(tmp_path / name) for name in ("start", "node.py", "a/b.yaml")
    ]


@pytest.fixture
def helper(tmp_path: Path) -> Iterator[Path]:
    """A module of a program, imported."""
    path = tmp_path / "midstride_test_helper.py"
    path.write_text("value = 1\n")
    spec = importlib.util.spec_from_file_location("midstride_test_helper", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["midstride_test_helper"] = module
    spec.loader.exec_module(module)
    yield path
    del sys.modules["midstride_test_helper"]


def test_a_process_lists_its_script_and_its_own_modules(helper: Path) -> None:
    script = helper.with_name("script.py")
    script.touch()
    main = ModuleType("__main__")
    main.__file__ = str(script)
    program = ProgramFiles({**sys.modules, "__main__": main}, LATER).listed()
    paths = [file.path for file in program.files]
    assert str(helper) in paths
    assert paths[0] == str(script)
    foreign = [asyncio, pytest, node_program]  # of the interpreter, of its environment, and of Midstride
    assert not {module.__file__ for module in foreign} & set(paths[1:])
    assert program.complete


@pytest.mark.parametrize("installed", ["under its name", "under its real path", "not at all"])
def test_a_module_of_the_environment_is_known_by_its_name_and_by_its_real_path(
    installed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An environment may link to files elsewhere, and a folder of modules may link into an environment."""
    (tmp_path / "environment").mkdir()
    (tmp_path / "own").mkdir()
    name, real = ("environment", "own") if installed == "under its name" else ("own", "environment")
    if installed == "not at all":
        name = real = "own"
    (tmp_path / real / "real.py").touch()
    path = tmp_path / name / "linked.py"
    path.symlink_to(tmp_path / real / "real.py")
    monkeypatch.setattr(node_program, "_environment", lambda: (f"{tmp_path}/environment/",))
    module = ModuleType("linked")
    module.__file__ = str(path)
    listed = [file.path for file in ProgramFiles({"linked": module}, LATER).listed().files]
    assert listed == ([str(path)] if installed == "not at all" else [])


def test_a_file_is_listed_as_it_was_when_it_was_listed_first(helper: Path) -> None:
    files = ProgramFiles(sys.modules, LATER)
    before = files.listed()
    helper.write_text("value = 2, later\n")
    assert files.listed() == before


def test_of_too_many_modules_it_says_so(helper: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node_program, "MOST_FILES", 1)
    program = ProgramFiles(sys.modules, LATER).listed()
    assert (len(program.files), program.complete) == (1, False)


def test_a_module_whose_path_no_text_can_express_is_not_listed_and_that_is_said(tmp_path: Path) -> None:
    """Under another name it would be taken for a file that has been deleted."""
    module = ModuleType("helper")
    module.__file__ = str(tmp_path / os.fsdecode(b"f\xfcnf.py"))
    Path(module.__file__).write_text("value = 1\n")
    program = ProgramFiles({"helper": module}, LATER).listed()
    assert (program.files, program.complete) == ([], False)


def test_a_lazy_module_is_not_loaded_for_its_file() -> None:
    class Lazy:
        def __getattr__(self, name: str) -> str:
            raise AssertionError(f"{name} was asked for")

    assert ProgramFiles({"lazy": Lazy()}, LATER).listed().files == []


def test_a_process_knows_when_it_started() -> None:
    assert 0 < time.time_ns() - process_started() < 3600e9
    before = process_started()
    with named("regelung_motorü"):
        assert process_started() == pytest.approx(before, abs=50e6)


# -- a system ----------------------------------------------------------------------------------------------


async def programs(manager: Manager) -> dict[str, ProgramStatus]:
    """Once all components have said which files they have."""
    while True:
        found = {program.name: program for program in await manager.programs()}
        if all(program.files for program in found.values()):
            return found
        await asyncio.sleep(0.1)


def test_an_edited_program_is_shown_until_its_node_is_restarted(tmp_path: Path) -> None:
    start = stateful_talkers(tmp_path)
    script = tmp_path / "Talker.py"

    async def body(manager: Manager, _: Simulator) -> None:
        async def shown() -> dict[str, list[str]]:
            return {each.name: each.changed_files or [] for each in (await manager.status()).instances}

        assert (await programs(manager))["talker"].files == [str(script)]
        assert await shown() == {"talker": [], "listener": []}
        script.write_text(script.read_text().replace('"+"', '"!"'))
        assert await shown() == {"talker": [str(script)], "listener": []}
        outcome = await manager.change(PlanRequest(to=start, restart=("talker",)))
        assert outcome.outcome == "done", outcome.because
        assert (await programs(manager)).keys() == {"talker_2", "listener"}
        assert await shown() == {"talker_2": [], "listener": []}

    (tmp_path / "workspace").mkdir()
    managed("talker", tmp_path / "workspace", body, specification=start)


def test_the_next_manager_knows_of_an_edit_that_the_earlier_one_did_not_see(tmp_path: Path) -> None:
    start, script, simulator = stateful_talkers(tmp_path), tmp_path / "Talker.py", Simulator()
    folder = tmp_path / "workspace"
    folder.mkdir()

    async def main() -> dict[str, ProgramStatus]:
        first = Manager(start, simulator, Workspace(folder), EXAMPLES / "talker")
        await first.up()
        await programs(first)
        await first.close()
        kept(script, script.read_text().replace('"+"', '"!"') + "# longer\n")
        second = Manager(start, simulator, Workspace(folder), EXAMPLES / "talker")
        await second.up()
        try:
            return await programs(second)
        finally:
            await second.close()

    found = simulator.run(main())
    assert {name: program.changed for name, program in found.items()} == {"talker": [str(script)], "listener": []}


def test_a_file_that_run_names_belongs_to_the_program(tmp_path: Path) -> None:
    start = stateful_talkers(tmp_path)
    options = tmp_path / "options.yaml"
    options.write_text("loud: true\n")
    talker = changed(start.components["Talker"], run=f"{start.components['Talker'].run} {options}")
    start = changed(start, components=start.components.set("Talker", talker))

    async def body(manager: Manager, _: Simulator) -> None:
        assert str(options) in (await programs(manager))["talker"].files
        options.write_text("loud: false\n")
        assert (await programs(manager))["talker"].changed == [str(options)]

    (tmp_path / "workspace").mkdir()
    managed("talker", tmp_path / "workspace", body, specification=start)


def test_a_file_that_was_touched_is_read_again_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    start = stateful_talkers(tmp_path)
    script, digest, hashed = tmp_path / "Talker.py", wire_program._digest, list[str]()

    def counted(path: str, size: int) -> str | None:
        hashed.append(path)
        return digest(path, size)

    async def body(manager: Manager, _: Simulator) -> None:
        await programs(manager)
        monkeypatch.setattr(wire_program, "_digest", counted)
        for moment in (1, 2):
            os.utime(script, ns=(moment, moment))
            for _again in range(3):
                assert (await programs(manager))["talker"].changed == []
            assert hashed == [str(script)] * moment
        text = script.read_text()
        script.write_text(text.replace('"+"', '"!"'))
        assert (await programs(manager))["talker"].changed == [str(script)]
        script.write_text(text)
        assert (await programs(manager))["talker"].changed == []

    (tmp_path / "workspace").mkdir()
    managed("talker", tmp_path / "workspace", body, specification=start)


def test_a_restart_beside_a_specification_names_a_node_of_it() -> None:
    specification = example("talker")
    with pytest.raises(PlanRefused, match="no node `talkr`"):
        PlanRequest(to=specification, restart=("talkr",)).target(specification)
    with pytest.raises(PlanRefused, match="not both"):
        PlanRequest(to=specification, remove=("talker",)).target(specification)
