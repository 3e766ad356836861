"""Writes what is generated from the source: ``python -m tools.reference``. ``--check`` names outdated ones.

`make reference` writes them, `make lint` checks them. Each has one source: the catalogue of diagnostics, the help of
the commands, the JSON Schema of specifications, the catalogue of metrics, the decisions for their index, the API's
forms for the checker of the dashboard's modules, and Click's scripts for completion.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

from midstride.codec.schema import specification_schema
from midstride.lang.catalogue import reference
from midstride.server.metrics.metric_catalogue import METRICS
from tools import completions
from tools.command_blocks import BLOCK, block, blocks
from tools.dashboard_types import declarations

ROOT: Final = Path(__file__).resolve().parent.parent
DOCS: Final = ROOT / "docs"
DECISIONS: Final = DOCS / "decisions"
_INDEX: Final = re.compile(r"(?<=<!-- index -->\n).*(?=<!-- end -->)", re.DOTALL)


def commands(page: str) -> str:
    """The page of the commands with its parts that are made from their help; ``ValueError`` if one has no place."""
    expected = blocks()
    if sorted(found["name"] for found in BLOCK.finditer(page)) != sorted(expected):
        raise ValueError("docs/reference/commands.md needs a place for each command, and for no other")
    return BLOCK.sub(lambda found: block(found["name"], expected[found["name"]]), page)


def schema(_: str) -> str:
    return json.dumps(specification_schema(), indent=2, ensure_ascii=False) + "\n"


def index(page: str) -> str:
    """The page of the decisions with the list of them, by the package of the first module that each names."""
    found: dict[str, list[str]] = {}
    for path in sorted(DECISIONS.glob("*.md")):
        if path.name == "README.md":
            continue
        text = path.read_text(encoding="utf-8")
        title, status, module = (
            re.search(pattern, text, re.MULTILINE)
            for pattern in (r"^# (.+)$", r"^- \*\*Status:\*\* (\w+)", r"^- \*\*Modules:\*\* `([^`]+)`")
        )
        if title is None or status is None or module is None:
            raise ValueError(f"{path} lacks its title, status or modules")
        package = "/".join(module[1].split("/")[:-1][:2])
        note = "" if status[1] == "accepted" else f" ({status[1]})"
        found.setdefault(package, []).append(f"- [{title[1]}]({path.name}){note}")
    lines = "\n".join(f"\n## `{package}`\n\n" + "\n".join(found[package]) for package in sorted(found))
    return _INDEX.sub(lambda _: f"{lines}\n\n", page)


def metrics(page: str) -> str:
    """The page of the metrics with the table of them."""
    rows = "".join(
        f"| `{each.name}` | {each.kind} | {', '.join(f'`{label}`' for label in each.labels)} | {each.help}"
        f"{f' Absent {each.absent}.' if each.absent else ''} |\n"
        for each in METRICS
    )
    return _INDEX.sub(
        lambda _: f"\n| metric | kind | labels besides `system` | meaning |\n|---|---|---|---|\n{rows}\n", page
    )


PAGES: Final[dict[Path, Callable[[str], str]]] = {
    DOCS / "reference" / "diagnostics.md": lambda _: reference(),
    DOCS / "reference" / "commands.md": commands,
    DOCS / "reference" / "specification.schema.json": schema,
    DOCS / "reference" / "metrics.md": metrics,
    DECISIONS / "README.md": index,
    ROOT / "tools" / "dashboard" / "api.d.ts": lambda _: declarations(),
    completions.FOLDER / "midstride.bash": lambda _: completions.script("bash"),
    completions.FOLDER / "midstride.zsh": lambda _: completions.script("zsh"),
    completions.FOLDER / "midstride.fish": lambda _: completions.script("fish"),
}


def outdated() -> dict[Path, str]:
    """The pages that differ from their sources, with what they should be."""
    kept = {path: path.read_text(encoding="utf-8") for path in PAGES}
    expected = {path: PAGES[path](text) for path, text in kept.items()}
    return {path: text for path, text in expected.items() if text != kept[path]}


def main() -> int:
    check = sys.argv[1:] == ["--check"]
    if sys.argv[1:] and not check:
        sys.exit(__doc__)
    found = outdated()
    for path, text in found.items():
        print(f"{path.relative_to(ROOT)} {'is out of date: run `make reference`' if check else 'is written'}")
        if not check:
            path.write_text(text, encoding="utf-8")
    return 1 if check and found else 0


if __name__ == "__main__":
    sys.exit(main())
