"""What a command runs, followed from its file: links, console scripts and modules (docs/protocols/programs.md)."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from midstride.runtime.view import followed_programs
from midstride.runtime.view.followed_programs import followed, followed_module, module_folders

SETUPTOOLS = """#!/usr/bin/python3
# EASY-INSTALL-ENTRY-SCRIPT: 'demo==0.0.0','console_scripts','talker'
import re
import sys
from importlib.metadata import distribution

def importlib_load_entry_point(spec, group, name):
    dist_name, _, _ = spec.partition('==')
    matches = (entry_point for entry_point in distribution(dist_name).entry_points
               if entry_point.group == group and entry_point.name == name)
    return next(matches).load()

globals().setdefault('load_entry_point', importlib_load_entry_point)

if __name__ == '__main__':
    sys.argv[0] = re.sub(r'(-script\\.pyw?|\\.exe)?$', '', sys.argv[0])
    sys.exit(load_entry_point('demo==0.0.0', 'console_scripts', 'talker')())
"""
PIP = """#!/usr/bin/python3
import re
import sys
from demo.nodes.talker import main
if __name__ == '__main__':
    sys.argv[0] = re.sub(r'(-script\\.pyw|\\.exe)?$', '', sys.argv[0])
    sys.exit(main())
"""
MODULES = {
    "demo/__init__.py": "",
    "demo/nodes/__init__.py": "",
    "demo/nodes/talker.py": "import os, other\nfrom .words import words\nfrom demo import numbers\n\ndef main(): ...\n",
    "demo/nodes/words.py": "from . import letters\nfrom .. import __init__ as whole\nwords = []\n",
    "demo/nodes/letters.py": "",
    "demo/nodes/unused.py": "",
    "demo/numbers.py": "import demo.nodes.talker  # a cycle\n",
    "other.py": "",
}


def planted(folder: Path) -> Path:
    """The modules, as they are installed, with the entry points of their distribution."""
    for name, text in MODULES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    about = folder / "demo-0.0.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: demo\nVersion: 0.0.0\n")
    (about / "entry_points.txt").write_text("[console_scripts]\ntalker = demo.nodes.talker:main\nother = demo.x:main\n")
    return folder


BEHIND = {"demo/__init__.py", "demo/nodes/__init__.py", "demo/nodes/talker.py", "demo/nodes/words.py"} | {
    "demo/nodes/letters.py",
    "demo/numbers.py",
}


@pytest.mark.parametrize("script", [SETUPTOOLS, PIP], ids=["setuptools", "pip"])
def test_a_console_script_is_followed_to_its_entry_point_and_within_its_package(tmp_path: Path, script: str) -> None:
    """Not to a module of another package, nor to one that nothing imports."""
    installed = planted(tmp_path / "prefix" / "lib" / "python3.11" / "site-packages")
    program = tmp_path / "prefix" / "lib" / "demo" / "talker"
    program.parent.mkdir()
    program.write_text(script, encoding="utf-8")
    folders = module_folders({"PYTHONPATH": "/nowhere"}, str(tmp_path / "prefix"))
    assert folders == ["/nowhere", str(installed)]
    found = followed(str(program), folders)
    assert found[0] == str(program)
    assert {os.path.relpath(path, installed) for path in found[1:]} == BEHIND


def test_an_entry_point_that_is_not_named_in_the_script_is_not_followed(tmp_path: Path) -> None:
    installed = planted(tmp_path / "prefix" / "lib" / "python3.11" / "site-packages")
    program = tmp_path / "talker"
    program.write_text(SETUPTOOLS.replace("'demo==0.0.0', 'console", "name, 'console"), encoding="utf-8")
    assert followed(str(program), [str(installed)]) == [str(program)]


def test_what_is_followed_is_what_python_imports(tmp_path: Path) -> None:
    """The slow twin: the script is run, and says which modules it has imported."""
    installed = planted(tmp_path / "modules")
    program = tmp_path / "talker"
    program.write_text(
        PIP.replace(
            "sys.exit(main())",
            "print(*(m.__file__ for m in sys.modules.values() if getattr(m, '__file__', None)), sep='\\n')",
        ),
        encoding="utf-8",
    )
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    run = subprocess.run([sys.executable, program], env=environment, capture_output=True, text=True, check=True)
    imported = {path for path in run.stdout.splitlines() if path.startswith(f"{installed}/demo/")}
    program.write_text(PIP, encoding="utf-8")
    found = {path for path in followed(str(program), [str(installed)]) if path.startswith(str(installed))}
    assert found == imported == {str(installed / name) for name in BEHIND}


def test_a_module_that_is_run_is_followed(tmp_path: Path) -> None:
    installed = planted(tmp_path / "modules")
    found = followed_module("demo.nodes.talker", ["/nowhere", str(installed)])
    assert {os.path.relpath(path, installed) for path in found} == BEHIND
    assert followed_module("demo.nodes.missing", [str(installed)]) == []


def test_a_script_is_followed_to_the_modules_beside_it(tmp_path: Path) -> None:
    script, beside, link = tmp_path / "talk.py", tmp_path / "words.py", tmp_path / "link"
    script.write_text("import sys, words\ndef main(): ...\nsys.exit(main())\n")
    beside.write_text("import json")
    assert followed(str(script), []) == [str(script), str(beside)]
    link.mkdir()
    (link / "talk").symlink_to(script)
    # Without the suffix and without a first line that says so, it is no program of Python; its link is followed.
    assert followed(str(link / "talk"), []) == [str(link / "talk"), str(script)]
    script.write_text(f"#!/usr/bin/env python3\n{script.read_text()}")
    assert followed(str(link / "talk"), []) == [str(link / "talk"), str(script), str(beside)]


def test_a_compiled_program_and_one_that_cannot_be_read_are_their_own_file_alone(tmp_path: Path) -> None:
    compiled, faulty = tmp_path / "compiled", tmp_path / "faulty.py"
    shutil.copy(shutil.which("true") or "/bin/true", compiled)
    faulty.write_text("def :\n")
    for path in (compiled, faulty, tmp_path / "missing"):
        assert followed(str(path), []) == [str(path)]


def test_no_more_files_are_followed_than_a_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(followed_programs, "MOST_FILES", 10)
    for number in range(30):
        (tmp_path / f"m{number}.py").write_text(f"import m{number + 1}\n")
    assert len(followed(str(tmp_path / "m0.py"), [])) == 10
