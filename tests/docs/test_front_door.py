"""The files that receive a contributor name commands, files and targets that exist; what is pinned is pinned."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

from midstride.cli.command_list import COMMANDS

ROOT = Path(__file__).parents[2]
PAGES = {"CONTRIBUTING.md": 700, "HACKING.md": 600, "SECURITY.md": 600, "RELEASING.md": 700, "docs/style.md": 700}
WORKFLOW = ROOT / ".github" / "workflows" / "ci.yml"
TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
# In these files, `make reference` and such is a command; no other line of a page begins with it.
MAKE = re.compile(r"\bmake((?: [a-z-]+)+)")


def text(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def commands(page: str) -> list[str]:
    """The commands of a page: the lines of its blocks for a shell, and all between back-quotes."""
    blocks = re.findall(r"^```sh\n(.*?)^```", text(page), re.MULTILINE | re.DOTALL)
    rest = re.sub(r"^```.*?^```", "", text(page), flags=re.MULTILINE | re.DOTALL)
    return [line.partition(" # ")[0].strip() for block in blocks for line in block.splitlines()] + re.findall(
        r"`([^`\n]+)`", rest
    )


def made(command: str) -> list[str]:
    """The targets that a command makes."""
    found = MAKE.search(command)
    return found[1].split() if found else []


@pytest.mark.parametrize("page", PAGES)
def test_a_page_is_short(page: str) -> None:
    assert len(text(page).split()) <= PAGES[page]


@pytest.mark.parametrize("page", PAGES)
def test_what_a_page_names_exists(page: str) -> None:
    checked = 0
    for command in commands(page):
        for target in made(command):
            assert target in TARGETS, command
        for path in re.findall(r"(?<![\w./-])(?:tests|tools|docs|src|examples|changes|\.ci)/[\w./-]+", command):
            if "VERSION" not in path:
                assert (ROOT / path).exists(), f"{page}: {path}"
                checked += 1
        words = command.split()
        for word, following in pairwise(words):
            if word.endswith("midstride") and re.fullmatch(r"[a-z]+", following):
                assert following in COMMANDS, command
                checked += 1
    for link in re.findall(r"\]\(([^)#]+)[^)]*\)", text(page)):
        if not link.startswith("https://"):
            assert ((ROOT / page).parent / link).exists(), f"{page}: {link}"
            checked += 1
    assert checked >= 3


def test_a_developer_runs_one_test_as_the_page_says() -> None:
    (command,) = [each for each in commands("CONTRIBUTING.md") if "test_usage" in each]
    environment = {**os.environ, "MIDSTRIDE_VENV": os.environ.get("MIDSTRIDE_VENV", str(ROOT / ".venv"))}
    words = [*shlex.split(command)[1:], "-p", "no:cacheprovider"]  # without tools/in-venv, in which this test runs
    done = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"\d+ passed", done.stdout)


def steps(job: dict[str, Any]) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = job["steps"]
    return found


def test_the_hosted_run_makes_the_targets_that_exist_with_pinned_actions() -> None:
    jobs = yaml.safe_load(WORKFLOW.read_text(encoding="utf-8"))["jobs"]
    targets = set()
    for name, job in jobs.items():
        assert job["timeout-minutes"] <= 90, name
        for image in [each["image"] for each in job.get("strategy", {}).get("matrix", {}).get("include", [])]:
            assert re.fullmatch(r"[a-z]+:[a-z-]+@sha256:[0-9a-f]{64}", image), image
        for step in steps(job):
            if uses := step.get("uses"):
                assert re.fullmatch(r"actions/[a-z-]+@[0-9a-f]{40}", uses), uses
            targets |= set(made(step.get("run", ""))) & TARGETS
    assert targets == {"lint", "test", "test-all"}
    assert {"3.10", "3.12", "3.13", "3.14"} == set(jobs["python"]["strategy"]["matrix"]["python"])


def test_the_hooks_call_what_lint_calls() -> None:
    hooks = yaml.safe_load(text(".pre-commit-config.yaml"))["repos"]
    assert [each["repo"] for each in hooks] == ["local"]
    lint = text("Makefile").partition("\nlint:")[2]
    for hook in hooks[0]["hooks"]:
        words = shlex.split(hook["entry"])
        if words[0] == "sh":
            words = words[2].removeprefix("exec ").split()
        assert words[0] == "tools/in-venv"
        plain = " ".join(word for word in words if not word.startswith("--force"))
        assert plain in lint, hook["entry"]


@pytest.mark.parametrize("template", sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("[!c]*.yml")))
def test_a_template_asks_for_something(template: Path) -> None:
    form = yaml.safe_load(template.read_text(encoding="utf-8"))
    assert form["name"] and form["description"]
    assert any(each["validations"]["required"] for each in form["body"])
