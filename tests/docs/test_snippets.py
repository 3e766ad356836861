"""Runs every snippet of the README, the documentation and the examples, in the order of the page.

A page is a session: its ``sh`` and ``python`` blocks run one after another in a copy of the examples. The language
may be followed by ``file=PATH`` (the block is written to that file instead) and ``exit=N`` (the expected exit
status; 0 by default). Each line of a ``text`` block must have been printed since the previous ``text`` block;
numbers may differ. Lines that call ``make`` are not run, since ``make`` runs this test, but their targets must exist.
Blocks of other languages are not run; ``json`` blocks must be valid JSON.
"""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.acceptance.support import ended

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "midstride"
PAGES = sorted(
    page
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")]
    if page.is_file()
)
ON_ROS_2 = {
    "docs/how-to/bring-your-robot.md",
    "docs/how-to/from-launch-files.md",
    "docs/how-to/from-rclpy-to-component.md",
    "docs/how-to/nav2.md",
    "docs/how-to/replace-a-server.md",
    "docs/how-to/services.md",
    "docs/how-to/unmodified-nodes.md",
    "docs/how-to/upgrade.md",
}
# With tens of processes of ROS 2, or commands that another live test runs as well.
LARGE = {"docs/how-to/from-rclpy-to-component.md", "docs/how-to/nav2.md", "docs/how-to/upgrade.md"}
RUN = {"sh", "python", "text", "json"}
# Plain rclpy may hang at its end: then it is killed (s), as a user does, and no later page has its nodes.
GIVEN_UP = 10
KILL = f"""kill() {{
    command kill "$1"
    (
        for i in $(seq {GIVEN_UP * 10}); do command kill -0 "$1" || exit 0; sleep 0.1; done
        command kill -9 "$1"
    ) > /dev/null 2>&1 &
}}
"""


@dataclass(frozen=True)
class Snippet:
    language: str
    options: dict[str, str]
    text: str
    line: int


def snippets(page: Path) -> Iterator[Snippet]:
    lines = iter(enumerate(page.read_text(encoding="utf-8").splitlines(), 1))
    for number, line in lines:
        if not line.startswith("```"):
            continue
        language, *words = line[3:].split() or [""]
        body: list[str] = []
        for _, inside in lines:
            if inside == "```":
                break
            body.append(inside)
        else:
            raise AssertionError(f"{page}:{number}: the block has no end")
        yield Snippet(language, dict(word.split("=", 1) for word in words), "\n".join(body) + "\n", number)


def without_make(snippet: Snippet) -> str:
    """The commands to run. Asserts that the targets of the omitted ``make`` commands exist."""
    kept = []
    for line in snippet.text.splitlines():
        words = line.split("#")[0].split()
        if words[:1] == ["make"]:
            dry = subprocess.run(["make", "-n", *words[1:]], cwd=ROOT, capture_output=True, text=True, check=False)
            assert dry.returncode == 0, dry.stderr
        else:
            kept.append(line)
    return "\n".join(kept)


def without_numbers(text: str) -> list[str]:
    """The lines without numbers and column widths, for comparison."""
    return [" ".join(re.sub(r"\d+(\.\d+)?( m?s)?", "#", line).split()) for line in text.splitlines()]


class Session:
    def __init__(self, folder: Path, backend: str) -> None:
        self.folder = folder
        shutil.copytree(ROOT / "examples", folder / "examples", ignore=shutil.ignore_patterns("__pycache__"))
        command = folder / "bin" / "midstride"
        command.parent.mkdir()
        command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m midstride "$@"\n')
        command.chmod(0o755)
        python = command.with_name("python3")  # the one that has ROS, as on a machine where ROS is set up
        python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
        python.chmod(0o755)
        ros2 = command.with_name("ros2")
        ros2.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{ROOT}/tests/ros2_command/ros2.py" "$@"\n')
        ros2.chmod(0o755)
        shutil.copytree(ROOT / "ansible", folder / "ansible", ignore=shutil.ignore_patterns("__pycache__"))
        for name in ("ansible-galaxy", "ansible-playbook"):  # with collections of the page's own
            program = command.with_name(name)
            collections = f'ANSIBLE_COLLECTIONS_PATH="{folder}/collections"'
            program.write_text(f'#!/bin/sh\nexec "{ROOT}/tools/ansible" env {collections} {name} "$@"\n')
            program.chmod(0o755)
        self.environment = {
            **{name: value for name, value in os.environ.items() if name != "MIDSTRIDE_DEMO"},
            "PATH": f"{command.parent}{os.pathsep}{os.environ['PATH']}",
            "XDG_RUNTIME_DIR": str(folder),
            "MIDSTRIDE_BACKEND": backend,
        }
        self.printed = ""

    def run(self, snippet: Snippet) -> None:
        if (path := snippet.options.get("file")) is not None:
            (self.folder / path).write_text(snippet.text, encoding="utf-8")
        elif snippet.language == "json":
            json.loads(snippet.text)
        elif snippet.language == "text":
            seen = without_numbers(self.printed)
            for line in without_numbers(snippet.text):
                assert line in seen, f"line {snippet.line}: {line!r} was not printed, but:\n{self.printed}"
            self.printed = ""
        elif snippet.language == "sh":
            commands = without_make(snippet)
            self._do(["sh", "-eu", "-c", KILL + commands if "kill " in commands else commands], snippet)
        elif snippet.language == "python":
            self._do([sys.executable, "-c", snippet.text], snippet)

    def _do(self, command: list[str], snippet: Snippet) -> None:
        done = subprocess.run(
            command,
            cwd=self.folder,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=100,
            check=False,
        )
        assert done.returncode == int(snippet.options.get("exit", "0")), f"line {snippet.line}:\n{done.stdout}"
        self.printed += done.stdout

    def close(self) -> list[str]:
        """End the systems that still run, and return their names."""
        left = [state.parent.name for state in self.folder.glob("midstride/*/state.db")]
        for system in left:
            command = [sys.executable, "-m", "midstride", "down", "--system", system]
            subprocess.run(command, env=self.environment, capture_output=True, check=True)
        return left


def play(page: Path, backend: str) -> None:
    folder = Path(tempfile.mkdtemp(prefix="ms"))  # sockets have short paths
    session = Session(folder, backend)
    with ended():
        try:
            for snippet in snippets(page):
                session.run(snippet)
            assert session.close() == []
        finally:
            session.close()
            shutil.rmtree(folder, ignore_errors=True)


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def marks(name: str) -> list[pytest.MarkDecorator]:
    """In `make test` are the pages that lead to the others."""
    needed = [pytest.mark.alloy] if name == "docs/how-to/verify.md" else []
    needed += [pytest.mark.ansible] if name == "docs/how-to/fleets.md" else []
    needed += [pytest.mark.ros2] if name in ON_ROS_2 else []
    if name in LARGE:
        return [*needed, pytest.mark.long]
    later = name.startswith(("docs/how-to/", "docs/reference/ten-", "examples/"))
    return needed + ([pytest.mark.full] if later else [])


WITH_CODE = [
    pytest.param(page, marks=marks(name_of(page)), id=name_of(page))
    for page in PAGES
    if any(snippet.language in RUN for snippet in snippets(page))
]


@pytest.mark.parametrize("page", WITH_CODE)
def test_every_snippet_runs(page: Path) -> None:
    play(page, "sim")


@pytest.mark.ros2
@pytest.mark.long
def test_the_readme_runs_on_ros_2() -> None:
    play(ROOT / "README.md", "ros2")


def test_a_process_that_does_not_end_when_a_page_ends_it_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(globals(), "KILL", KILL.replace(f"seq {GIVEN_UP * 10}", "seq 2"))
    page = tmp_path / "page.md"
    ignores = "sh -c 'trap \"\" TERM; echo ready; while :; do sleep 0.1; done' > said &\nchild=$!"
    ready = "until grep -q ready said; do sleep 0.01; done"
    page.write_text(
        f"```sh\n{ignores}\n{ready}\nkill $child && wait $child || echo status $?\n```\n```text\nstatus 137\n```\n"
    )
    play(page, "sim")


def test_a_snippet_that_is_wrong_fails(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    for text in (
        "```sh\nmidstride --versoin\n```\n",
        "```python\nraise SystemExit(3)\n```\n",
        "```sh\nmake no-such-target\n```\n",
        "```sh\necho one 1\n```\n```text\ntwo 2\n```\n",
        "```json\n{]\n```\n",
        "```sh\ntrue\n",
    ):
        page.write_text(text)
        with pytest.raises((AssertionError, ValueError)):
            play(page, "sim")
    page.write_text("```sh exit=2\nmidstride --versoin\n```\n```sh\necho one   12.5 ms\n```\n```text\none 3\n```\n")
    play(page, "sim")


LINK = re.compile(r"\]\((?!https?:|#)([^)#\s]+)")
PATH = re.compile(r"`([a-z_]+(?:/[a-z_0-9]+)*/[a-z_0-9]+\.py)`")


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_what_is_linked_and_named_is_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for link in LINK.findall(text):
        assert (page.parent / link).exists(), f"{name_of(page)} links to {link}"
    for path in PATH.findall(text):
        assert (SOURCE / path).exists() or (ROOT / path).exists(), f"{name_of(page)} names {path}"


def test_every_name_in_the_glossary_exists() -> None:
    """The parentheses at the end of each entry hold nothing but names below ``midstride``."""
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8").replace("\n  ", " ")
    rows = [line for line in text.splitlines() if line.startswith("- **")]
    assert len(rows) > 40
    for row in rows:
        cell = row.removesuffix(")").rpartition(" (")[2]
        names = re.findall(r"`([^`]+)`", cell)
        assert names and cell.strip() == ", ".join(f"`{name}`" for name in names), row
        for name in names:
            assert _resolves(f"midstride.{name}"), name


def _resolves(name: str) -> bool:
    """Whether ``name`` is a module, or an attribute of one."""
    module, attributes = name, list[str]()
    while True:
        try:
            found: object = importlib.import_module(module)
            break
        except ModuleNotFoundError:
            module, _, attribute = module.rpartition(".")
            attributes.insert(0, attribute)
    for index, attribute in enumerate(attributes):
        if hasattr(found, attribute):
            found = getattr(found, attribute)
        else:  # a field of a dataclass, which is the last part of a name
            return index == len(attributes) - 1 and attribute in getattr(found, "__annotations__", {})
    return True


def test_a_wrong_name_in_the_glossary_fails() -> None:
    assert _resolves("midstride.plan.plan.Plan.disruption")
    assert not _resolves("midstride.plan.plan.Plan.disruptoin")
    assert not _resolves("midstride.plan.plann.Plan")
