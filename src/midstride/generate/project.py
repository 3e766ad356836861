"""The files of a generated project: skeletons, launch file, package files, and copies of the specification."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any, Final, Literal

from jinja2 import Environment, PackageLoader, StrictUndefined

from midstride.errors import SpecificationError
from midstride.generate.generated_names import ProgramFile, program, snake
from midstride.generate.merge import BEGIN, END, with_mark
from midstride.generate.skeleton import skeleton
from midstride.model.component import ComponentSpec
from midstride.model.printable import on_one_line
from midstride.model.specification import Specification

ProjectKind = Literal["component", "whole", "copy", "empty"]


@dataclass(frozen=True, slots=True)
class GeneratedFile:
    """A file, and how it is merged into an existing one: see :mod:`midstride.generate.merge`."""

    path: PurePosixPath
    text: str
    kind: ProjectKind
    executable: bool = False


@dataclass(slots=True)
class Project:
    """The files of the package ``package``, and why some components have none."""

    package: str
    files: list[GeneratedFile] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)


# The package of the services by which a container loads a node.
_LOADING: Final = "composition_interfaces"
_COMMENT: Final = {".xml": ("<!-- ", " -->"), ".launch": ("<!-- ", " -->")}

_TEMPLATES: Final = Environment(
    loader=PackageLoader("midstride.generate"),
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
    undefined=StrictUndefined,
    autoescape=False,
)
# The names in a specification are identifiers; that of a file may have any character.
_TEMPLATES.filters |= {
    "repr": repr,
    "sh": shlex.quote,
    "printable": on_one_line,
    "docstring": lambda text: repr(text)[1:-1].replace('"', "'"),
    "cmake": lambda text: re.sub(r'([\\"$])', r"\\\1", text),
}


def project(
    specification: Specification,
    file: str,
    sources: Mapping[PurePosixPath, str],
    ros: Literal[1, 2] = 2,
    packages: Iterable[str] = (),
) -> Project:
    """The project of a system specified in ``file``; ``sources`` are its files, by path relative to its folder.
    Other files of it are in ``packages``.

    The copy of the specification states its containers, so that none is started but by ``midstride up``. Raises
    SpecificationError for what ROS 1 does not have, and for a component whose skeleton cannot be written.
    """
    composable = sorted(each.name for each in specification.components.values() if each.container is not None)
    if ros == 1 and composable:
        raise SpecificationError(
            f"{', '.join(composable)}: ROS 1 has no composable nodes (`run component`); omit `--ros 1`, or state a "
            "program for each (`run`)"
        )
    builder = _ProjectBuilder(specification, file, sources, Project(snake(specification.name)), packages=set(packages))
    builder.packages |= {each.package for each in specification.containers.values()}
    for _, component in sorted(specification.components.items()):
        builder.component(component)
    builder.result.files += [GeneratedFile(path, text, "copy") for path, text in sources.items()]
    builder.package_files(ros)
    return builder.result


@dataclass(slots=True)
class _ProjectBuilder:
    specification: Specification
    file: str
    sources: Mapping[PurePosixPath, str]
    result: Project
    programs: dict[PurePosixPath, tuple[ProgramFile, str]] = field(default_factory=dict)  # each with its component
    packages: set[str] = field(default_factory=set)

    def component(self, component: ComponentSpec) -> None:
        """Add the skeleton of a component, or the reason why it has none."""
        skipped, run = self.result.skipped, None if component.run is None else program(component.run)
        if component.package is not None:
            self.packages.add(component.package)
        if component.container is not None:
            self.packages |= {component.container.package, _LOADING}
            skipped[component.name] = f"it is a composable node, whose code is in the package {component.package}"
        elif component.run is None:
            skipped[component.name] = "it has no `run` command: it is started elsewhere"
        elif component.gate is not None:
            skipped[component.name] = "its program does not use Midstride's API: it has a gate"
        elif run is None:
            skipped[component.name] = f"`{component.run}` does not run a Python file in this folder"
        elif run.path in self.programs:
            skipped[component.name] = f"it runs {run.path}, which is the program of {self.programs[run.path][1]}"
        else:
            self.programs[run.path] = run, component.name
            made = skeleton(component, self._node(component.name), self.specification.environment)
            self.packages.update(made.packages)
            text = _TEMPLATES.get_template("component.py.j2").render(
                c=made, system=self.specification.name, file=self.file, begin=BEGIN, end=END
            )
            self.result.files.append(GeneratedFile(run.path, text, "component"))
            for parent in run.path.parents:
                init = parent / "__init__.py"
                if parent != PurePosixPath(".") and all(other.path != init for other in self.result.files):
                    self.result.files.append(GeneratedFile(init, "", "empty"))

    def _node(self, component: str) -> str:
        """The name of a node of the component; the component's name in snake case if it has none."""
        nodes = self.specification.nodes
        roles = (role for role in self.specification.roles() if nodes[role].component == component)
        return next(roles, snake(component)).rpartition("/")[2]

    def package_files(self, ros: Literal[1, 2]) -> None:
        """Add what makes the project a package of ROS, with its launch file."""
        system = self.specification.name
        package = self.result.package
        packaged = [run.path for run, _ in self.programs.values() if run.packaged]
        folders = {".".join(parent.parts) for path in packaged for parent in path.parents if parent.parts}
        context: dict[str, Any] = {
            "system": system,
            "package": package,
            "file": self.file,
            "ros": ros,
            "dependencies": sorted(self.packages),
            "packages": sorted(folders),
            "shared": self._installed_files(),
        }
        self._add_file("package.xml", f"package{ros}.xml.j2", context)
        self._add_file("setup.py", "setup.py.j2", context)
        if ros == 2:
            self._add_file(f"launch/{system}.launch.py", "launch.py.j2", context)
            self.result.files.append(GeneratedFile(PurePosixPath(f"resource/{package}"), "", "empty"))
        else:
            self._add_file("CMakeLists.txt", "CMakeLists.txt.j2", context)
            self._add_file(f"launch/{system}.launch", "launch.xml.j2", context)
            self._add_file("up.sh", "up.sh.j2", context, executable=True)

    def _installed_files(self) -> list[tuple[str, list[str]]]:
        """The files to install into the folder that the system runs in, by subfolder (``""`` or ``/parts``): the
        specification, and the programs that are run by path."""
        folders: dict[str, list[str]] = {}
        programs = sorted(run.path for run, _ in self.programs.values() if not run.packaged)
        for path in [*self.sources, *programs]:
            folder = "" if len(path.parts) == 1 else f"/{path.parent}"
            folders.setdefault(folder, []).append(str(path))
        return sorted(folders.items())

    def _add_file(self, path: str, template: str, context: dict[str, Any], executable: bool = False) -> None:
        text = _TEMPLATES.get_template(template).render(mark="@MARK@", **context)
        text = with_mark(text, *_COMMENT.get(PurePosixPath(path).suffix, ("# ", "")))
        self.result.files.append(GeneratedFile(PurePosixPath(path), text, "whole", executable))
