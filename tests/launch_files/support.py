"""Launch files for the tests, and what an import makes of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from midstride.lang import format_text, load
from midstride.launch_files.launch_import import Imported, import_launch_file
from midstride.model.specification import Specification


def imported(path: Path, arguments: Mapping[str, str] | None = None, **environment: str) -> Imported:
    """The import of a file, which is formatted, and has no errors when it is checked."""
    found = import_launch_file(path, arguments or {}, environment, path.parent / "imported.stride")
    assert format_text(found.text).text == found.text
    specification(found, path.parent)
    return found


def specification(found: Imported, folder: Path) -> Specification:
    file = folder / "imported.stride"
    file.write_text(found.text, encoding="utf-8")
    for name, text in found.parameter_files.items():
        (folder / name).write_text(text, encoding="utf-8")
    loaded = load(file)
    assert [str(each) for each in loaded.diagnostics if each.severity == "error"] == []
    return loaded.require()


def of_xml(folder: Path, body: str, arguments: Mapping[str, str] | None = None, **environment: str) -> Imported:
    """The import of a launch file with these elements."""
    file = folder / "robot.launch.xml"
    file.write_text(f"<launch>\n{body}\n</launch>\n", encoding="utf-8")
    return imported(file, arguments, **environment)


def kinds(found: Imported) -> list[str]:
    return [finding.kind for finding in found.findings]


def commands(found: Imported, folder: Path) -> dict[str, str]:
    """The command of each node, by its name."""
    system = specification(found, folder)
    return {node.role: str(system.components[node.component].run) for node in system.nodes.values()}
