"""What starting a launch file comes to: processes in a form in which ROS's launch and an import can be compared."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from midstride.model.component_rules import MAX_NUMBER

CATALOGUE: Final = Path(__file__).parent / "catalogue"
PACKAGE: Final = "made_up_pkg"
DEFAULT_LIMIT: Final = 5.0  # seconds until the next signal, for a process that does not end
TOOL: Final = "made_up_tool"
# A node that a process may have besides the one that the launch file names.
OTHER: Final = "/made_up_group/other"
# The programs of the package, each of which would call its node like itself.
PROGRAMS: Final = ("worker", "camera")
_RULES: Final = {"-r": "-r", "--remap": "-r", "-p": "-p", "--param": "-p", "--params-file": "--params-file"}
# What a machine has in its environment besides is not compared, but for one that every machine has.
_SHOWN: Final = frozenset({"ONLY", "OTHER", "A", "PATH"})
_ALONE: Final = frozenset(
    f"--{able}-{where}-logs" for able in ("enable", "disable") for where in ("rosout", "stdout", "external-lib")
)


def split(words: Sequence[str]) -> tuple[list[str], list[tuple[str, str]]]:
    """The program's own arguments, and the rules and options for ROS in their order, each with its value or ""."""
    own: list[str] = []
    rules: list[tuple[str, str]] = []
    position = 0
    for_ros = False
    while position < len(words):
        word = words[position]
        position += 1
        if word == "--ros-args":
            for_ros = True
        elif not for_ros:
            own.append(word)
        elif word == "--":
            for_ros = False
        elif word in _ALONE or position == len(words):
            rules.append((word, ""))
        else:
            rules.append((_RULES.get(word, word), words[position]))
            position += 1
    return own, rules


def prefix_folder(folder: Path) -> Path:
    """An ament prefix with the package of the catalogue, made below ``folder``."""
    prefix = folder / "prefix"
    index = prefix / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / PACKAGE).touch()
    (prefix / "share" / PACKAGE).symlink_to(CATALOGUE / PACKAGE)
    (prefix / "lib" / PACKAGE).mkdir(parents=True)
    for name in PROGRAMS:
        program = prefix / "lib" / PACKAGE / name
        program.write_text("#!/bin/sh\nexit 1\n", encoding="utf-8")
        program.chmod(0o755)
    (prefix / "bin").mkdir()
    tool = prefix / "bin" / TOOL
    tool.write_text("#!/bin/sh\nexit 1\n", encoding="utf-8")
    tool.chmod(0o755)
    return prefix


def surroundings(prefix: Path, base: Mapping[str, str]) -> dict[str, str]:
    """The environment in which the launch files of the catalogue are launched, or imported."""
    return {
        **{name: value for name, value in base.items() if not name.startswith("MADE_UP")},
        "AMENT_PREFIX_PATH": os.pathsep.join([str(prefix), base.get("AMENT_PREFIX_PATH", "")]),
        "PATH": f"{prefix / 'bin'}{os.pathsep}{base.get('PATH', '')}",
        "MADE_UP_SET": "given",
    }


def shortened(text: str, prefix: Path) -> str:
    """``text`` without what differs from one machine to the next."""
    text = re.sub(r"/\S*/launch_params_\w+", "<written>", text)
    for folder, name in ((prefix / "share" / PACKAGE, "<share>"), (CATALOGUE, "<here>"), (prefix, "<prefix>")):
        text = text.replace(str(folder), name)
    return text


def for_others(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """What another node of a process has. Without what the language cannot state, which is for one node."""
    return {
        name: plain(parameters[name])
        for name in sorted(parameters)
        if re.fullmatch(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*", name, re.ASCII)
        and not (isinstance(parameters[name], str) and (len(parameters[name]) > 1000 or "\n" in parameters[name]))
        and parameters[name] != []
        and not (isinstance(parameters[name], (int, float)) and MAX_NUMBER < abs(parameters[name]) < math.inf)
    }


def plain(value: Any) -> Any:
    """The value of a parameter in JSON, which has no infinite numbers."""
    if isinstance(value, list):
        return [plain(each) for each in value]
    return {"float": repr(value)} if isinstance(value, float) and not math.isfinite(value) else value


def environment_change(before: Mapping[str, str], after: Mapping[str, str]) -> dict[str, str | None]:
    """The variables that a process has in addition, or with another value; None for one that it has not."""
    return {
        name: after.get(name)
        for name in sorted({*before, *after})
        if before.get(name) != after.get(name) and (name.startswith("MADE_UP") or name in _SHOWN)
    }


def cases() -> Iterator[tuple[str, Path, dict[str, str]]]:
    """The launch files of the catalogue with their arguments."""
    arguments = json.loads((CATALOGUE / "arguments.json").read_text(encoding="utf-8"))
    for path in sorted(CATALOGUE.glob("*.launch.*")):
        yield path.name, path, arguments.get(path.name, {})
