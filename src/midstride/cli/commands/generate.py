"""``generate``: node skeletons, a launch file and package files from a specification."""

from __future__ import annotations

import json
import os
from pathlib import Path, PurePosixPath
from typing import Final

import click

from midstride.cli.input_files import require_file, write, written
from midstride.cli.output import json_option, show
from midstride.cli.specification_argument import specification_argument
from midstride.errors import MidstrideError, SpecificationError
from midstride.generate.merge import Merged, digest, merge_component, merge_copy, merge_whole
from midstride.generate.project import GeneratedFile, project
from midstride.lang import Loaded, load
from midstride.lang.message_types import installed
from midstride.package_files import SCHEME, owner

# What was last generated, to recognise a copy of the specification that was edited since.
RECORD: Final = ".midstride-generated.json"


@click.command("generate")
@specification_argument()
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="The folder to write to; it is made if there is none.",
)
@click.option("--ros", type=click.Choice(["1", "2"]), default="2", show_default=True, help="For ROS 1 or ROS 2.")
@json_option
def generate_command(file: Path, output: Path, ros: str) -> int:
    """Write a skeleton for each node of FILE into DIR, with a launch file and package files.

    The nodes run unchanged: `midstride up DIR/FILE`, or `midstride up PACKAGE FILE` once DIR is built in a workspace.
    Generating again keeps your code and replaces only the marked block in each file.
    """
    require_file(file)
    loaded = load(file, messages=installed())
    specification = loaded.require()
    sources, packages = _sources(file, loaded)
    generated_project = project(specification, file.name, sources, 1 if ros == "1" else 2, packages)
    record = _record(output)
    done: list[tuple[str, str, str]] = []
    for generated in generated_project.files:
        path = output / generated.path
        merged = _merge(generated, _existing(path), record)
        if merged.text is not None:
            _write(path, merged.text, generated.executable)
        if generated.kind == "copy" and (merged.text is not None or not merged.note):
            record[str(generated.path)] = digest(generated.text)
        done.append((str(generated.path), "written" if merged.text is not None else "kept", merged.note))
    _write(output / RECORD, json.dumps(record, indent=2, sort_keys=True) + "\n", False)
    files = [{"file": name, "state": state, "note": note or None} for name, state, note in done]
    noted = [(name, state, f" ({note})" if note else "") for name, state, note in done if state == "written" or note]
    lines = [f"{state} {output / name}{note}" for name, state, note in noted]
    lines += [f"no skeleton for {component}: {reason}" for component, reason in generated_project.skipped.items()]
    name = generated_project.package
    build = "colcon" if ros == "2" else "catkin"
    lines.append(f"Built with {build} and sourced, it starts with `midstride up {name} {file.name}`.")
    lines.append(f"Start it with `midstride up {output / file.name}`.")
    elsewhere = [
        host for host in sorted(specification.hosts) if any(n.host == host for n in specification.nodes.values())
    ]
    for host in elsewhere:
        roles = ", ".join(role for role, node in sorted(specification.nodes.items()) if node.host == host)
        lines.append(
            f"{roles}: on host {host}, where this package has to be built as well; launch itself starts nothing there."
        )
    document = {"folder": str(output), "package": name, "files": files, "skipped": generated_project.skipped}
    show({**document, "hosts": elsewhere} if elsewhere else document, lines)
    return 0


def _sources(file: Path, loaded: Loaded) -> tuple[dict[PurePosixPath, str], list[str]]:
    """The files of the specification, relative to the folder of ``file``, and the packages that the others are of.

    Raises SpecificationError for one outside that is not found by the name of its package.
    """
    sources: dict[PurePosixPath, str] = {}
    packages: set[str] = set()
    folder = os.path.abspath(file.parent)
    for source in loaded.files:
        relative = os.path.relpath(os.path.abspath(source.path or file), folder)
        if relative.startswith(".."):
            owned = owner(str(source.path), os.environ)
            if owned is not None and any(f'"{SCHEME}{owned[0]}/' in other.text for other in loaded.files):
                packages.add(owned[0])
                continue
            raise SpecificationError(f"{source.name} is outside {folder}, so a copy of {file} would not find it")
        sources[PurePosixPath(relative)] = source.text
    return sources, sorted(packages)


def _merge(generated: GeneratedFile, existing: str | None, record: dict[str, str]) -> Merged:
    if generated.kind == "component":
        return merge_component(existing, generated.text)
    if generated.kind == "whole":
        return merge_whole(existing, generated.text)
    if generated.kind == "empty":
        return Merged("" if existing is None else None)  # it only has to exist
    return merge_copy(existing, generated.text, record.get(str(generated.path)))


def _existing(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError) as error:
        raise MidstrideError(f"cannot read {path}: {error}") from None


def _write(path: Path, text: str, executable: bool) -> None:
    with written(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write(path, text)
        if executable:
            path.chmod(path.stat().st_mode | 0o111)


def _record(output: Path) -> dict[str, str]:
    try:
        found = json.loads((output / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return {str(path): str(value) for path, value in found.items()} if isinstance(found, dict) else {}
