"""The reference pages: what is generated is up to date, snippets of the language parse, every option is documented."""

from __future__ import annotations

import re
from pathlib import Path

import click
import pytest

from midstride.cli.command_list import COMMANDS, cli
from midstride.lang import format_text, render
from midstride.lang.token_stream import RESERVED
from tools.reference import commands, outdated

DOCS = Path(__file__).parents[2] / "docs"
REFERENCE = DOCS / "reference"


def test_the_generated_pages_are_up_to_date() -> None:
    """`make reference` writes them anew."""
    assert [str(path) for path in outdated()] == []


def test_a_page_that_is_not_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    page = REFERENCE / "commands.md"
    monkeypatch.setattr(
        "tools.reference.PAGES", {page: lambda text: text.replace("midstride check", "midstride chekc")}
    )
    assert list(outdated()) == [page]


def test_a_command_without_a_place_in_the_page_is_found() -> None:
    with pytest.raises(ValueError, match="a place for each command"):
        commands("a page without commands")


@pytest.mark.parametrize(("page", "fewest"), [("reference/language.md", 6), ("semantics.md", 1)])
def test_every_snippet_of_the_language_parses_and_is_canonical(page: str, fewest: int) -> None:
    text = (DOCS / page).read_text(encoding="utf-8")
    snippets = re.findall(r"```stride\n(.*?)```", text, re.DOTALL)
    assert len(snippets) >= fewest
    for snippet in snippets:
        found = format_text(snippet)
        assert found.text == snippet, render(found.diagnostics) or found.text


def test_every_statement_is_in_the_language_page() -> None:
    text = (REFERENCE / "language.md").read_text(encoding="utf-8")
    assert {word for word in RESERVED if not re.search(rf"\b{word}\b", text)} == set()


def test_every_option_is_somewhere_in_the_documentation() -> None:
    text = "\n".join(page.read_text(encoding="utf-8") for page in DOCS.rglob("*.md"))
    context = click.Context(cli)
    missing = set()
    for name in COMMANDS:
        command = cli.get_command(context, name)
        assert command is not None
        parts = command.commands.values() if isinstance(command, click.Group) else [command]
        for option in (each for part in parts for each in part.params if isinstance(each, click.Option)):
            if not any(re.search(rf"(?<![\w-]){each}(?![\w-])", text) for each in option.opts):
                missing.add((name, option.opts[0]))
    assert missing == set()


def test_the_figures_of_the_readme_are_those_of_the_measurements() -> None:
    """The median gap, and what was missed and duplicated, for each way of replacing a publisher on ROS 2."""

    def rows(page: Path, heading: str) -> list[list[str]]:
        table = page.read_text(encoding="utf-8").partition(heading)[2].partition("\n\n")[0]
        return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]

    measured = [(row[1], row[3], row[4]) for row in rows(DOCS / "benchmarks.md", "| ROS 2 | gap, median")]
    shown = [
        (row[1].removesuffix(" periods"), *row[2:]) for row in rows(DOCS.parent / "README.md", "| | longest silence")
    ]
    assert len(measured) == 9
    assert sorted(shown) == sorted(measured)
