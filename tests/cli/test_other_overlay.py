"""The executables of packages that this shell finds elsewhere than the manager does."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.cli.changed_programs import other_overlay
from midstride.runtime.records.status_forms import ProgramStatus


def overlay(folder: Path, *names: str) -> Path:
    """A prefix with the package `demo`, which has these executables."""
    index = folder / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "demo").touch()
    for name in names:
        path = folder / "lib" / "demo" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("#!/bin/sh\n")
        path.chmod(0o755)
    return folder


def program(role: str, executable: Path | None) -> ProgramStatus:
    found = None if executable is None else str(executable)
    return ProgramStatus(name=role, role=role, files=[], changed=[], unknown=None, startable=True, executable=found)


def test_what_this_shell_finds_elsewhere_is_said_once_for_all_nodes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, other = overlay(tmp_path / "one", "talk", "hear"), overlay(tmp_path / "other", "talk")
    theirs = one / "lib" / "demo"
    programs = [program("b", theirs / "talk"), program("a", theirs / "talk"), program("c", theirs / "hear")]
    programs.append(program("d", None))
    for same in (f"{one}", f"{one}:{other}", "/nowhere", ""):
        monkeypatch.setenv("AMENT_PREFIX_PATH", same)
        assert list(other_overlay(programs)) == []
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{other}:{one}")
    assert list(other_overlay(programs)) == [  # where the other overlay has no `hear`, nothing could be started there
        f"b, a: `talk` of package demo is {other}/lib/demo/talk in this shell, and {theirs}/talk for the manager, "
        "which starts that one; `midstride down`, and `midstride up` in this shell, use the other"
    ]
    (tmp_path / "link").symlink_to(one)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "link"))
    assert list(other_overlay(programs)) == []
