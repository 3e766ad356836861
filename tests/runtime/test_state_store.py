"""What the next manager finds: what was written, row by row, whatever became of the one that wrote it."""

from __future__ import annotations

import os
import resource
import shutil
import sqlite3
import stat
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace as changed
from pathlib import Path

import pytest
from immutables import Map
from msgspec import structs

from midstride.errors import ManagerError
from midstride.model.component import ComponentSpec, Connector, EnvironmentGuarantee, Resource
from midstride.model.configuration import Instance
from midstride.model.contract import Predicate
from midstride.model.specification import Order, Specification
from midstride.runtime.backend_protocol import Handle
from midstride.runtime.options import NO_OPTIONS, SystemOptions
from midstride.runtime.records.disk import ClosingConnection, Disk
from midstride.runtime.records.state_store import VERSION, SavedInstance, StateStore
from tests.runtime.systems import example

SPECIFICATION = example("talker")
TALKER = SPECIFICATION.instance("talker")
TEXT = Predicate("std_msgs/msg/String")
HANDLE = Handle("talker", 4711, 12.5, "/tmp/talker.log")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    folder = tmp_path / "patrol"
    folder.mkdir()
    return folder / "state.db"


def begun(path: Path) -> StateStore:
    store = StateStore(path)
    store.begin("sim", "a token", SPECIFICATION)
    return store


def test_what_up_was_given_is_found_and_a_state_without_it_is_read(path: Path) -> None:
    store = begun(path)
    assert_options(path, NO_OPTIONS)
    given = SystemOptions(use_sim_time=True, middleware_settings=False, diagnostics=False)
    store.begin("sim", "a token", SPECIFICATION, given)
    assert_options(path, given)
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("DELETE FROM system WHERE key = 'options'")
    assert_options(path, NO_OPTIONS)


def test_a_specification_is_that_of_its_file_until_another_command_changes_it(path: Path) -> None:
    store = StateStore(path)
    other = changed(SPECIFICATION, constraints=(Order("talker", "listener"),))

    def origin() -> tuple[str | None, bool]:
        saved = store.load()
        assert saved is not None
        return saved.file, saved.changed_since

    store.begin("sim", "a token", SPECIFICATION, file="/r/talker.stride")
    assert origin() == ("/r/talker.stride", False)
    store.write_specification(other)
    assert origin() == ("/r/talker.stride", True)
    store.begin("sim", "a token", other, file="/r/talker.stride", changed_since=True)
    assert origin() == ("/r/talker.stride", True)
    store.write_file("/r/new.stride")
    assert origin() == ("/r/new.stride", False)


def assert_options(path: Path, expected: SystemOptions) -> None:
    found = StateStore(path).load()
    assert found is not None and found.options == expected


def test_a_later_up_adds_to_what_an_earlier_one_was_given() -> None:
    sim_time, untouched = SystemOptions(use_sim_time=True), SystemOptions(middleware_settings=False)
    assert sim_time.with_(NO_OPTIONS) == sim_time and untouched.with_(NO_OPTIONS) == untouched
    assert sim_time.with_(untouched) == untouched.with_(sim_time) == SystemOptions(True, False)
    assert not SystemOptions(diagnostics=False).with_(NO_OPTIONS).diagnostics
    for name, asked in [("finish_interrupted", True), ("keep_degraded", True), ("diagnostics", False), ("spares", 2)]:
        once = structs.replace(NO_OPTIONS, **{name: asked})
        assert once.with_(NO_OPTIONS) == NO_OPTIONS.with_(once) == once.with_(once) == once


def test_what_was_written_is_found(path: Path) -> None:
    assert StateStore(path).load() is None
    store = begun(path)
    store.write_instance(TALKER, HANDLE)
    elsewhere = Instance("by_hand", "by_hand", TALKER.component, Map())
    store.write_instance(elsewhere, None)
    found = StateStore(path).load()
    assert found is not None
    assert (found.backend, found.token, found.specification) == ("sim", "a token", SPECIFICATION)
    assert found.instances == (SavedInstance(elsewhere, None), SavedInstance(TALKER, HANDLE))
    assert stat.S_IMODE(path.stat().st_mode) == 0o600, "it holds the token of the system"


@pytest.mark.parametrize("name", ["a folder", "#1", "what?", "100%25", "ü"])
def test_the_state_is_found_in_a_folder_of_any_name(name: str, tmp_path: Path) -> None:
    folder = tmp_path / name
    folder.mkdir()
    begun(folder / "state.db").close()
    found = StateStore(folder / "state.db").load()
    assert found is not None and found.specification == SPECIFICATION
    assert [path.name for path in tmp_path.iterdir()] == [name], "and nothing is created elsewhere"


def test_paths_that_are_no_utf_8_are_kept_as_escapes(path: Path) -> None:
    store = begun(path)
    store.write_file(os.fsdecode(b"/robots/f\xfcnf/talker.stride"))
    store.write_instance(TALKER, Handle("talker", 4711, 12.5, os.fsdecode(b"/robots/f\xfcnf.log")))
    found = StateStore(path).load()
    assert store.unwritten is None and found is not None
    assert found.file == r"/robots/f\udcfcnf/talker.stride"
    [saved] = found.instances
    assert saved.handle is not None and saved.handle.log == r"/robots/f\udcfcnf.log"


def test_an_instance_is_replaced_and_removed(path: Path) -> None:
    store = begun(path)
    store.write_instance(TALKER, HANDLE)
    other = changed(TALKER, parameters=TALKER.parameters.set("words", "other"))
    store.write_instance(other, HANDLE)
    found = StateStore(path).load()
    assert found is not None
    assert [entry.instance for entry in found.instances] == [other]
    store.remove_instance("talker")
    store.remove_instance("never there")
    found = StateStore(path).load()
    assert found is not None
    assert found.instances == ()


def test_the_specification_is_replaced(path: Path) -> None:
    store = begun(path)
    target = SPECIFICATION.without_node("listener")
    store.write_specification(target)
    found = StateStore(path).load()
    assert found is not None
    assert found.specification == target


def statements(store: StateStore, write: Callable[[], None]) -> list[str]:
    """What ``write`` writes, without the values."""
    found: list[str] = []
    database = store._open().connection
    database.set_trace_callback(found.append)
    write()
    database.set_trace_callback(None)
    return [words.split(" VALUES")[0] for words in found if words.startswith(("INSERT", "DELETE", "UPDATE"))]


def test_only_what_differs_of_the_specification_is_written(path: Path) -> None:
    store = begun(path)
    listener = SPECIFICATION.nodes["listener"]
    other = changed(listener, attachments=Map())
    target = changed(SPECIFICATION, nodes=SPECIFICATION.nodes.set("listener", other))
    insert = "INSERT OR REPLACE INTO specification"
    assert statements(store, lambda: store.write_specification(target)) == [insert, "INSERT OR REPLACE INTO system"]
    assert statements(store, lambda: store.write_specification(target)) == []
    found = StateStore(path).load()
    assert found is not None and found.specification == target


@pytest.mark.parametrize(
    "target",
    [
        changed(SPECIFICATION, connectors=SPECIFICATION.connectors.set("/new", Connector("/new", TEXT))),
        changed(SPECIFICATION, components=SPECIFICATION.components.set("Empty", ComponentSpec.of("Empty"))),
        changed(SPECIFICATION, resources=Map({"memory": Resource("memory", 3.0)})),
        changed(SPECIFICATION, environment=(EnvironmentGuarantee("sun", TEXT, "/chatter"),)),
        changed(SPECIFICATION, constraints=(Order("talker", "listener"),)),
        changed(SPECIFICATION, timing=Map({"create": 2.0})),
        changed(SPECIFICATION, constraints=(Order("talker", "no node"),)),  # it ran, whatever its names are
    ],
    ids=["topics", "components", "resources", "environment", "constraints", "timing", "names"],
)
def test_each_part_of_the_specification_comes_and_goes(path: Path, target: Specification) -> None:
    store = begun(path)
    for specification in (target, SPECIFICATION):
        store.write_specification(specification)
        found = StateStore(path).load()
        assert found is not None and found.specification == specification


def test_a_specification_that_the_disk_refused_is_written_later(path: Path) -> None:
    store = begun(path)
    target = SPECIFICATION.without_node("listener")
    with closing(sqlite3.connect(path)) as blocker, blocker:
        store._open().connection.execute("PRAGMA busy_timeout = 0")
        blocker.execute("BEGIN IMMEDIATE")
        store.write_specification(target)
        assert store.unwritten is not None
    blocker.close()
    store.require()
    found = StateStore(path).load()
    assert found is not None and found.specification == target


def test_what_the_disk_refused_does_not_undo_what_was_asked_for_since(path: Path) -> None:
    store = begun(path)
    with closing(sqlite3.connect(path)) as blocker, blocker:
        store._open().connection.execute("PRAGMA busy_timeout = 0")
        blocker.execute("BEGIN IMMEDIATE")
        store.write_specification(SPECIFICATION.without_node("listener"))
        assert store.unwritten is not None
    blocker.close()
    store.begin("sim", "a token", SPECIFICATION)
    found = StateStore(path).load()
    assert found is not None and found.specification == SPECIFICATION


def test_a_manager_after_which_another_has_taken_over_saves_nothing_more(path: Path) -> None:
    first, second = begun(path), StateStore(path)
    first.write_instance(TALKER, HANDLE)
    second.take_over()
    assert first.superseded, "it is known before a write has failed"
    first.remove_instance("talker")
    with pytest.raises(ManagerError, match="another manager of this system has taken over"):
        first.require()
    second.require()
    found = StateStore(path).load()
    assert found is not None and found.instances == (SavedInstance(TALKER, HANDLE),)
    assert (first.superseded, second.superseded) == (True, False)
    first.close()
    second.delete()
    second.begin("sim", "another token", SPECIFICATION)
    assert second.unwritten is None


def test_what_was_refused_to_a_manager_is_not_written_to_a_database_that_it_begins_anew(path: Path) -> None:
    first, second = begun(path), StateStore(path)
    second.take_over()
    first.write_instance(TALKER, HANDLE)
    assert first.superseded
    second.close()
    first.delete()
    first.begin("sim", "a token", SPECIFICATION)
    found = StateStore(path).load()
    assert first.unwritten is None and found is not None and found.instances == ()


def test_a_manager_that_was_killed_before_it_could_start_anything_left_nothing(path: Path) -> None:
    StateStore(path)._open().close()
    assert path.exists() and StateStore(path).load() is None


def test_what_a_system_begins_with_is_one_transaction(path: Path) -> None:
    store, found = StateStore(path), list[str]()
    store._open().connection.set_trace_callback(found.append)
    store.begin("sim", "a token", SPECIFICATION)
    assert found.count("COMMIT") == 1 and found[-1] == "COMMIT"


def test_a_file_is_created_whole_or_not_at_all(path: Path) -> None:
    with pytest.raises(sqlite3.Error):
        Disk().open(path, "CREATE TABLE one (x); nonsense")  # the manager is killed half-way
    assert not path.exists()
    Disk().open(path, "CREATE TABLE IF NOT EXISTS two (x)").close()
    database = Disk().read_only(path)
    assert database is not None
    assert database.read("SELECT name FROM sqlite_master") == [("two",)]
    database.close()


def test_a_deleted_store_leaves_nothing_and_may_be_deleted_again(path: Path) -> None:
    store = begun(path)
    store.delete()
    assert list(path.parent.iterdir()) == []
    assert StateStore(path).load() is None
    store.delete()


class FullDisk(ClosingConnection):
    """A connection whose commits fail while ``full``."""

    full = False

    def execute(self, *arguments: object) -> sqlite3.Cursor:
        if FullDisk.full and str(arguments[0]).startswith(("INSERT", "DELETE")):
            raise sqlite3.OperationalError("database or disk is full")
        return super().execute(*arguments)  # type: ignore[arg-type]


def test_a_disk_that_refuses_is_reported_once_and_caught_up_with(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    connect = sqlite3.connect

    def connected(*arguments: object, **options: object) -> sqlite3.Connection:
        return connect(*arguments, **(options | {"factory": FullDisk}))  # type: ignore[call-overload, no-any-return]

    monkeypatch.setattr(sqlite3, "connect", connected)
    monkeypatch.setattr(FullDisk, "full", False)
    warnings: list[str] = []
    store = StateStore(path, warnings.append)
    store.begin("sim", "a token", SPECIFICATION)
    monkeypatch.setattr(FullDisk, "full", True)
    store.write_instance(TALKER, HANDLE)
    store.remove_instance("listener")
    assert len(warnings) == 1
    assert "disk is full" in warnings[0]
    assert "disk is full" in str(store.unwritten)
    with pytest.raises(ManagerError, match="disk is full"):
        store.require()
    found = StateStore(path).load()
    assert found is not None
    assert found.instances == (), "nothing is half written"
    monkeypatch.setattr(FullDisk, "full", False)
    store.require()  # or it raises
    found = StateStore(path).load()
    assert found is not None
    assert [entry.handle for entry in found.instances] == [HANDLE], "what the disk refused was lost"


@contextmanager
def full_disk() -> Iterator[None]:
    """Meanwhile no file can get longer."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("killed", [False, True])
def test_what_an_earlier_manager_left_is_read_on_a_full_disk(killed: bool, path: Path, tmp_path: Path) -> None:
    store = begun(path)
    store.write_instance(TALKER, HANDLE)
    left = path
    if killed:  # after a restart of the machine, only its index of the write-ahead log is missing
        left = tmp_path / "state.db"
        for suffix in ("", "-wal"):
            shutil.copy(f"{path}{suffix}", f"{left}{suffix}")
    store.close()
    with full_disk():
        found = StateStore(left).load()
    assert found is not None and found.instances == (SavedInstance(TALKER, HANDLE),)
    assert StateStore(left).load() == found


def test_a_state_that_cannot_be_read_now_is_not_called_damaged(path: Path) -> None:
    begun(path).close()
    path.with_name("state.db-wal").mkdir()
    with pytest.raises(ManagerError, match=r"cannot read .*state\.db now: .* keep running; make room"):
        StateStore(path).load()
    path.with_name("state.db-wal").rmdir()
    assert StateStore(path).load() is not None


DEEP = '{"a": ' * 100_000 + "1" + "}" * 100_000


@pytest.mark.parametrize("content", [b"", b"{", b"SQLite format 3\0 and then nothing", b"\0" * 5000])
def test_a_state_that_cannot_be_read_says_what_to_do(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(ManagerError, match="it is unknown which components of patrol still run: stop them yourself"):
        StateStore(path).load()


@pytest.mark.parametrize(
    ("statement", "why"),
    [
        ("DELETE FROM system WHERE key = 'token'", "token"),
        ("UPDATE specification SET form = '[]' WHERE section = 'nodes'", "nodes"),
        ("DELETE FROM system WHERE key = 'token'", "it is damaged: it has no 'token'"),
        ("DELETE FROM system", "it is damaged: it has no version"),
        ("UPDATE system SET value = x'ff' WHERE key = 'token'", "it is damaged: .*UTF-8"),
        ("DELETE FROM specification WHERE section = 'rest'", "system"),
        (f"UPDATE specification SET form = '{DEEP}' WHERE section = 'rest'", "it is damaged: it is nested too deep"),
        (
            f"UPDATE specification SET form = '{DEEP}' WHERE section = 'components'",
            "it is damaged: it is nested too deep",
        ),
        (
            "UPDATE specification SET form = '[1]' WHERE section = 'rest'",
            "it is damaged: Expected `object`, got `array`",
        ),
        (
            "UPDATE specification SET form = 'null' WHERE section = 'rest'",
            "it is damaged: Expected `object`, got `null`",
        ),
        ("UPDATE specification SET section = 'system' WHERE section = 'topics'", "it is damaged: /system"),
        ('UPDATE specification SET form = \'{"system": "patrol", "nodes": 5}\' WHERE section = \'rest\'', None),
        (
            "UPDATE specification SET form = '{\"topics\": [1' WHERE section = 'rest'",
            "it is damaged: Input data was tr",
        ),
        ("UPDATE specification SET form = x'00ff' WHERE section = 'nodes'", "it is damaged: JSON is malformed"),
        (f"UPDATE instances SET form = '{DEEP}'", "it is damaged: Object contains unknown field"),
        (f"UPDATE instances SET handle = '{DEEP}'", "it is damaged: it is nested too deep"),
        ("DROP TABLE instances", "it is damaged: no such table: instances"),
        ("UPDATE instances SET form = '{}'", "name"),
        ("UPDATE instances SET handle = '{\"pid\": 5}'", "instance"),
    ],
)
def test_a_state_that_makes_no_sense_says_so(path: Path, statement: str, why: str | None) -> None:
    """The file, that it is damaged and how, what became of the components, and what to do."""
    store = begun(path)
    store.write_instance(TALKER, HANDLE)
    store.close()
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(statement)
    database.close()
    if why is None:  # what the rest says of the other sections is not used
        assert StateStore(path).load() is not None
        return
    with pytest.raises(ManagerError, match=why) as raised:
        StateStore(path).load()
    words = str(raised.value)
    assert words.startswith(f"cannot read {path}: ") and "Error" not in words
    assert "they keep running" in words and f"{path.parent / 'components'}), then remove the file" in words


@pytest.mark.parametrize(("version", "which"), [(VERSION - 1, "an earlier"), (VERSION + 1, "a newer")])
def test_the_state_of_another_version_says_which_one_to_use(path: Path, version: int, which: str) -> None:
    begun(path).close()
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE system SET value = ? WHERE key = 'version'", (str(version),))
    database.close()
    expected = (
        f"{which} version of Midstride wrote it, in form {version}, and this one reads {VERSION}. .* keep running"
    )
    with pytest.raises(ManagerError, match=expected):
        StateStore(path).load()


def test_what_has_been_written_is_not_written_again(path: Path) -> None:
    store = begun(path)
    insert = "INSERT OR REPLACE INTO instances"
    assert statements(store, lambda: store.write_instance(TALKER, HANDLE)) == [insert]
    [deleted] = statements(store, lambda: store.remove_instance("listener"))
    assert deleted.startswith("DELETE FROM instances")


def test_a_write_costs_a_row_whatever_the_size_of_the_system(path: Path) -> None:
    """Not timed: what is written is counted."""
    store = begun(path)
    statements: list[str] = []
    for index in range(50):
        store.write_instance(changed(TALKER, name=f"talker_{index}"), HANDLE)
    assert store._database is not None
    store._database.connection.set_trace_callback(statements.append)
    store.write_instance(changed(TALKER, name="talker_7"), HANDLE)
    assert [statement.split()[0] for statement in statements] == ["BEGIN", "SELECT", "INSERT", "COMMIT"]
