"""Executables of packages in planted prefixes: looked up at the start, by `check`, and in the language."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from midstride.ament_index import executable, installed_program
from midstride.backends.simulator import Simulator
from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.errors import StartFailed
from midstride.lang import format_text
from midstride.lang.catalogue_entry import CHATTER, NODE
from midstride.lang.load import load
from midstride.plan.specification_diff import component_differences
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace

TEXT = CHATTER.replace("  output", '  run "talker --loud" package "demo_nodes" takes 1 s\n  output') + NODE


def planted(prefix: Path, package: str, *programs: str) -> str:
    """A prefix in which ``package`` is installed with these programs; its path."""
    index = prefix / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / package).touch()
    folder = prefix / "lib" / package
    folder.mkdir(parents=True)
    for name in programs:
        (folder / name).write_text("#!/bin/sh\n", encoding="utf-8")
        (folder / name).chmod(0o755)
    return str(prefix)


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["{}/lib/demo_nodes/talker"], ("talker", "demo_nodes")),
        (["{}/lib/demo_nodes/talker", "--loud", "--ros-args", "-r", "__node:=x"], ("talker --loud", "demo_nodes")),
        (["/usr/bin/python3", "{}/lib/demo_nodes/talker", "--ros-args"], ("talker", "demo_nodes")),
        (
            "{}/lib/demo_nodes/talker --ros-args -p a:=1 -r m:__ns:=/n -e /x --log-level warn -- -u --ros-args "
            "--remap c:=d --remap __name:=y --params-file f".split(),
            ("talker -u --ros-args -p a:=1 --log-level warn --remap c:=d --params-file f", "demo_nodes"),
        ),
        (["/usr/bin/python3", "-u", "{}/lib/demo_nodes/talker"], None),
        (["{}/lib/other_nodes/talker"], None),
        (["lib/demo_nodes/talker"], None),
        (["{}/bin/demo_nodes/talker"], None),
        ([], None),
    ],
)
def test_which_installed_program_a_process_is(tmp_path: Path, words: list[str], found: tuple[str, str] | None) -> None:
    prefix, proc = planted(tmp_path / "demo", "demo_nodes", "talker"), tmp_path / "proc" / "7"
    proc.mkdir(parents=True)
    (proc / "cmdline").write_text("".join(f"{word.format(prefix)}\0" for word in words), encoding="utf-8")
    assert installed_program(7, str(tmp_path / "proc")) == found
    assert installed_program(8, str(tmp_path / "proc")) is None


def test_the_first_prefix_with_the_package_counts(tmp_path: Path) -> None:
    other = planted(tmp_path / "other", "other_nodes", "talker")
    overlay = planted(tmp_path / "overlay", "demo_nodes", "talker")
    underlay = planted(tmp_path / "underlay", "demo_nodes", "talker", "listener")
    environment = {"AMENT_PREFIX_PATH": f"{other}:{overlay}:{underlay}"}
    assert executable("demo_nodes", "talker", environment) == f"{overlay}/lib/demo_nodes/talker"
    (tmp_path / "overlay" / "lib" / "demo_nodes" / "readme").touch()
    for name, words in (
        ("listener", f"has no executable listener in {overlay}/lib/demo_nodes"),
        ("talkr", f"has no executable talkr in {overlay}/lib/demo_nodes; did you mean `talker`?"),
        ("readme", "has no executable readme"),  # it is a file, and cannot be run
    ):
        with pytest.raises(StartFailed) as caught:
            executable("demo_nodes", name, environment)
        assert words in str(caught.value)


def test_what_was_searched_is_named(tmp_path: Path) -> None:
    prefix = planted(tmp_path, "demo_nodes")
    with pytest.raises(StartFailed, match="AMENT_PREFIX_PATH is not set"):
        executable("demo_nodes", "talker", {})
    with pytest.raises(StartFailed) as caught:
        executable("no_nodes", "talker", {"AMENT_PREFIX_PATH": f"/nowhere:{prefix}"})
    assert str(caught.value) == (
        "package no_nodes is not installed: there is no share/ament_index/resource_index/packages/no_nodes "
        f"in /nowhere or {prefix}"
    )


def warnings(path: Path) -> list[str]:
    return [f"{each.position}: {each.message}" for each in load(path).diagnostics if each.code == "W161"]


def test_the_package_of_a_program_is_read_written_and_looked_up_by_check(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "s.stride"
    path.write_text(TEXT, encoding="utf-8")
    monkeypatch.setenv("AMENT_PREFIX_PATH", planted(tmp_path / "prefix", "demo_nodes"))
    (found,) = warnings(path)
    assert found.startswith("(4, 31): component Talker runs `talker --loud`, but package demo_nodes has no executable")
    (tmp_path / "prefix" / "lib" / "demo_nodes" / "talker").symlink_to("/bin/true")
    assert warnings(path) == []
    specification = load(path).require()
    talker = specification.components["Talker"]
    assert (talker.run, talker.package, talker.startup_seconds) == ("talker --loud", "demo_nodes", 1)
    assert decode_specification(encode_specification(specification)) == specification
    assert format_text(TEXT).text == TEXT
    path.write_text(TEXT.replace("demo_nodes", "other_nodes"), encoding="utf-8")
    assert not load(path).require().components["Talker"].same_body(talker)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('"demo_nodes"', '"../demo"', "`../demo` is not a valid package name"),
        ('"talker --loud"', '"./talker"', "`./talker` names a file, and package demo_nodes is stated"),
        ('"demo_nodes"', "demo_nodes", "expected a package in double quotes after `package`"),
    ],
)
def test_what_cannot_be_meant_is_reported(before: str, after: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "s.stride"
    path.write_text(TEXT.replace(before, after), encoding="utf-8")
    assert any(message in each.message for each in load(path).diagnostics if each.severity == "error")


def test_a_platform_without_packages_says_so(tmp_path: Path) -> None:
    path = tmp_path / "s.stride"
    path.write_text(TEXT, encoding="utf-8")
    simulator = Simulator()
    (tmp_path / "system").mkdir()
    manager = Manager(load(path).require(), simulator, Workspace(tmp_path / "system"), tmp_path)

    async def scenario() -> None:
        with pytest.raises(Exception, match="talker is in package demo_nodes, which the back end sim cannot look up"):
            await manager.up()
        await asyncio.sleep(0)
        await manager.close()

    simulator.run(scenario())


def test_a_program_has_a_prefix_and_an_environment(tmp_path: Path) -> None:
    text = TEXT.replace(
        " takes 1 s\n",
        ' prefix "nice -n 5" takes 1 s\n  environment { MODE = "a b", unset DISPLAY }\n',
    )
    path = tmp_path / "s.stride"
    path.write_text(text, encoding="utf-8")
    specification = load(path).require()
    talker = specification.components["Talker"]
    assert talker.prefix == "nice -n 5" and dict(talker.environment) == {"MODE": "a b", "DISPLAY": None}
    assert decode_specification(encode_specification(specification)) == specification
    assert format_text(text).text == text
    for before, after in (("nice -n 5", "nice -n 6"), ("a b", "a c"), (", unset DISPLAY", "")):
        path.write_text(text.replace(before, after), encoding="utf-8")
        other = load(path).require().components["Talker"]
        assert not other.same_body(talker) and list(component_differences(talker, other))


def test_like_inherits_and_replaces_variables_one_by_one(tmp_path: Path) -> None:
    path = tmp_path / "s.stride"
    like = 'component Other like Talker { environment { B = "2", unset C } }\n'
    text = TEXT.replace("  output", '  environment { A = "1", B = "1", C = "1" }\n  output')
    path.write_text(text + like, encoding="utf-8")
    other = load(path).require().components["Other"]
    assert dict(other.environment) == {"A": "1", "B": "2", "C": None}


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ('environment { MIDSTRIDE_TOKEN = "x" }', "`MIDSTRIDE_TOKEN` of the environment is set by Midstride itself"),
        ("environment { A = 1 }", "expected a value in double quotes"),
        ('environment { A = "1", A = "2" }', "duplicate variable `A`"),
        ("environment { unset }", "expected a statement in the environment"),
        ('run "./x" prefix "\'"', "is not a valid shell command"),
    ],
)
def test_what_is_no_environment_or_prefix_is_reported(statement: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "s.stride"
    path.write_text(CHATTER.replace("  output", f"  {statement}\n  output") + NODE, encoding="utf-8")
    errors = [each.message for each in load(path).diagnostics if each.severity == "error"]
    assert any(message in each for each in errors), errors
