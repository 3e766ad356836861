"""The catalogue: every entry is reachable and documented, and is rendered as recorded.

`MIDSTRIDE_GOLDEN=write` rewrites the recorded renderings; read the difference before you commit it.
"""

from __future__ import annotations

import ast
import os
import re
from pathlib import Path

import pytest

from midstride.lang import load, render
from midstride.lang.catalogue import CATALOGUE, explain
from midstride.lang.catalogue_entry import CatalogueExample

from .known import Known

GOLDEN = Path(__file__).parent.parent / "golden" / "diagnostics"
SOURCE = Path(__file__).parents[2] / "src" / "midstride"


def written(example: CatalogueExample, folder: Path) -> Path:
    for name, text in {example.name: example.text, **example.files}.items():
        (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder / example.name


@pytest.mark.parametrize("code", CATALOGUE)
def test_every_entry_is_reachable_and_rendered_as_recorded(
    code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable in ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH"):
        monkeypatch.delenv(variable, raising=False)
    shown = []
    for number, example in enumerate(CATALOGUE[code].examples):
        folder = tmp_path / str(number)
        folder.mkdir()
        monkeypatch.chdir(folder)
        loaded = load(written(example, folder).name, messages=Known())
        others = {d.code for d in loaded.diagnostics if d.severity == "error"} - {code}
        assert others == ({"E110"} if code == "E199" else set()), render(loaded.diagnostics)
        assert code in {d.code for d in loaded.diagnostics}, render(loaded.diagnostics)
        assert (loaded.specification is None) == (CATALOGUE[code].severity == "error")
        shown.append(render(loaded.diagnostics[-1:] if code == "E199" else loaded.diagnostics))
    text = "\n\n----\n\n".join(shown) + "\n"
    golden = GOLDEN / f"{code}.txt"
    if os.environ.get("MIDSTRIDE_GOLDEN") == "write":
        golden.parent.mkdir(parents=True, exist_ok=True)
        golden.write_text(text, encoding="utf-8")
    assert text == golden.read_text(encoding="utf-8")


def test_every_golden_rendering_has_an_entry() -> None:
    assert {path.stem for path in GOLDEN.iterdir()} == set(CATALOGUE)


def test_every_code_in_the_source_has_an_entry() -> None:
    used = set()
    for path in (path for package in ("model", "codec", "lang") for path in (SOURCE / package).glob("*.py")):
        if path.name.startswith("catalogue"):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if (
                isinstance(node, ast.Constant)
                and isinstance(node.value, str)
                and re.fullmatch(r"[EW]\d{3}", node.value)
            ):
                used.add(node.value)
    assert used == set(CATALOGUE)


@pytest.mark.parametrize("code", CATALOGUE)
def test_every_entry_is_documented(code: str) -> None:
    entry = CATALOGUE[code]
    assert len(entry.explanation.split()) >= 6
    assert entry.title == entry.title.strip(". ")
    assert entry.examples
    assert explain(code).startswith(f"{entry.severity} {code}: {entry.title}\n")


def test_a_similar_code_is_suggested_for_an_unknown_one() -> None:
    with pytest.raises(KeyError, match="there is no diagnostic `E0012`; did you mean `E001`"):
        explain("E0012")
    assert explain("e012") == explain("E012")
