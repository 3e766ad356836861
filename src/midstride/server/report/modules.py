"""The page's modules as one script: a file that is opened from disk may not import others.

Each module becomes a function that returns what it exports, in the order in which they need each other. This relies on
a few forms that the modules keep to, and that are checked: named imports of relative files, exports in front of a
declaration, no cycles.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path, PurePosixPath
from typing import Final

from midstride.errors import MidstrideError

_IMPORT: Final = re.compile(r'^import\s+(?:\{(?P<names>[^}]*)\}\s*from\s*)?"(?P<file>[^"]+)";', re.MULTILINE)
_EXPORT: Final = re.compile(
    r"^export\s+(?P<what>(?:async\s+)?(?:function\*?|class|const))\s+(?P<name>\w+)", re.MULTILINE
)
# What would be left out, or not be the same, if it were taken for something else.
_OTHER: Final = re.compile(r"^\s*(?:import\b(?!\()|export\b)|\bimport\(\s*[^)\s]", re.MULTILINE)
_COMMENT: Final = re.compile(r"^[ \t]*(?:/\*[\s\S]*?\*/|//[^\n]*)|(?<=[(=]) ?/\*\* @type [^\n]*?\*/", re.MULTILINE)
_NAME: Final = re.compile(r"^(?P<name>\w+)(?:\s+as\s+(?P<alias>\w+))?$")


def inlined(folder: Path, entry: str) -> str:
    """The module ``entry`` of ``folder``, and all that it imports, as one script. Raises MidstrideError."""
    done: dict[str, str] = {}
    _add(folder, PurePosixPath(entry), done, ())
    return "\n".join(done.values())


def _add(folder: Path, name: PurePosixPath, done: dict[str, str], above: tuple[str, ...]) -> str:
    """The variable that holds the exports of a module; it and those that it imports are ``done`` afterwards."""
    key = str(name)
    variable = "m_" + re.sub(r"\W", "_", key)
    if key in above:
        raise MidstrideError(f"modules of the dashboard import each other: {' -> '.join([*above, key])}")
    if key in done:
        return variable
    text = _COMMENT.sub("", (folder / key).read_text(encoding="utf-8")) if "vendor" not in name.parts else ""
    if not text:  # a library: one script that sets a global
        done[key] = f"(function () {{\n{(folder / key).read_text(encoding='utf-8')}\n}}).call(globalThis);"
        return variable
    imports: list[str] = []
    for found in _IMPORT.finditer(text):
        file = PurePosixPath(posixpath.normpath(name.parent / found["file"]))
        source = _add(folder, file, done, (*above, key))
        if found["names"]:
            imports.append(f"const {{ {', '.join(_names(found['names'], key))} }} = {source};")
    exports = [found["name"] for found in _EXPORT.finditer(text)]
    body = _EXPORT.sub(r"\g<what> \g<name>", _IMPORT.sub("", text))
    if (other := _OTHER.search(body)) is not None:
        raise MidstrideError(f"{key} of the dashboard has an import or export of another form: {other[0].strip()}")
    inner = "\n".join(line for line in [*imports, body.strip()] if line)
    done[key] = f"const {variable} = (() => {{\n{inner}\nreturn {{ {', '.join(exports)} }};\n}})();"
    return variable


def _names(text: str, key: str) -> list[str]:
    found: list[str] = []
    for part in filter(None, (each.strip() for each in text.split(","))):
        match = _NAME.match(part)
        if match is None:
            raise MidstrideError(f"{key} of the dashboard has an import of another form: {part}")
        found.append(f"{match['name']}: {match['alias']}" if match["alias"] else match["name"])
    return found
