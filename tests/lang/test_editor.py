"""The VS Code extension: its grammar knows the language's words, and npm can package it."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from midstride.lang.token_stream import RESERVED

FOLDER = Path(__file__).parents[2] / "editors" / "vscode"
GRAMMAR = json.loads((FOLDER / "syntaxes" / "stride.tmLanguage.json").read_text(encoding="utf-8"))
SAMPLE = (Path(__file__).parent / "seeds" / "patrol.stride").read_text(encoding="utf-8")


def matches(rule: str, text: str) -> list[str]:
    return [match.group() for match in re.finditer(GRAMMAR["repository"][rule]["match"], text)]


def test_the_grammar_knows_every_word_of_the_language() -> None:
    words = set(re.findall(r"[a-zA-Z_]+", GRAMMAR["repository"]["keyword"]["match"]))
    assert words >= RESERVED


def test_the_grammar_finds_what_there_is() -> None:
    assert "component ObstacleDetector" in matches("declaration", SAMPLE)
    assert "sensor_msgs/msg/LaserScan" in matches("type", SAMPLE)
    assert "/cmd_vel" in matches("path", SAMPLE)
    assert "0.5 s" in matches("quantity", SAMPLE)
    assert {"<-", "->", "<=", "@"} <= set(matches("operator", SAMPLE))
    assert set(re.findall(r"#(\w+)", json.dumps(GRAMMAR["patterns"]))) == set(GRAMMAR["repository"])


def test_every_file_that_the_manifest_names_is_there() -> None:
    manifest = json.loads((FOLDER / "package.json").read_text(encoding="utf-8"))
    contributed = manifest["contributes"]
    named = [
        manifest["main"],
        *(language["configuration"] for language in contributed["languages"]),
        *(grammar["path"] for grammar in contributed["grammars"]),
    ]
    assert [name for name in named if not (FOLDER / name).exists()] == []
    # With `files`, vsce leaves out the modules that the extension needs; without, what is in `.vscodeignore`.
    assert "files" not in manifest
    assert "node_modules" not in (FOLDER / ".vscodeignore").read_text(encoding="utf-8")


@pytest.mark.skipif(shutil.which("npm") is None, reason="npm is not installed")
def test_npm_can_package_it(tmp_path: Path) -> None:
    shutil.copytree(FOLDER, tmp_path / "vscode", ignore=shutil.ignore_patterns("node_modules"))
    done = subprocess.run(
        ["npm", "pack", "--json", "--offline"], cwd=tmp_path / "vscode", capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    packed = {entry["path"] for entry in json.loads(done.stdout)[0]["files"]}
    assert packed == {
        "README.md",
        "language-configuration.json",
        "package.json",
        "src/extension.js",
        "syntaxes/stride.tmLanguage.json",
    }


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_the_script_of_the_editor_is_javascript() -> None:
    subprocess.run(["node", "--check", str(FOLDER / "src" / "extension.js")], check=True)
