"""The files of a generated project: skeletons, launch file, package files, and copies of the specification."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any, Final, Literal

from jinja2 import Environment, PackageLoader, StrictUndefined

from midstride.generate.merge import BEGIN, END, with_mark
from midstride.generate.names import ProgramFile, program, snake
from midstride.generate.skeleton import Skeleton, skeleton
from midstride.model.component import ComponentSpec
from midstride.model.specification import Specification

Kind = Literal["component", "whole", "copy", "empty"]


@dataclass(frozen=True, slots=True)
class GeneratedFile:
    """A file, and how it is merged into an existing one: see :mod:`midstride.generate.merge`."""

    path: PurePosixPath
    text: str
    kind: Kind
    executable: bool = False


@dataclass(slots=True)
class Project:
    """The files, and why some components have none."""

    files: list[GeneratedFile] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)


_COMMENT: Final = {".xml": ("<!-- ", " -->")}


def project(
    specification: Specification, file: str, sources: Mapping[PurePosixPath, str], ros: Literal[1, 2] = 2
) -> Project:
    """The project of a system specified in ``file``; ``sources`` are its files, by path relative to its folder."""
    return _ProjectBuilder(specification, file, sources, ros).build()


class _ProjectBuilder:
    def __init__(
        self, specification: Specification, file: str, sources: Mapping[PurePosixPath, str], ros: Literal[1, 2]
    ) -> None:
        self.specification = specification
        self.file = file
        self.sources = sources
        self.ros = ros
        self.result = Project()
        self.programs: dict[PurePosixPath, tuple[ProgramFile, str]] = {}  # each with its component
        self.packages: set[str] = set()
        self.templates = Environment(
            loader=PackageLoader("midstride.generate"),
            trim_blocks=True,
            lstrip_blocks=True,
            keep_trailing_newline=True,
            undefined=StrictUndefined,
            autoescape=False,
        )
        self.templates.filters["repr"] = repr

    def build(self) -> Project:
        for name in sorted(self.specification.components):
            self._component(self.specification.components[name])
        for path, text in self.sources.items():
            self.result.files.append(GeneratedFile(path, text, "copy"))
        self._package_files()
        return self.result

    def _component(self, component: ComponentSpec) -> None:
        run = None if component.run is None else program(component.run)
        if component.run is None:
            self.result.skipped[component.name] = "it has no `run` command: it is started elsewhere"
        elif run is None:
            self.result.skipped[component.name] = f"`{component.run}` does not run a Python file in this folder"
        elif run.path in self.programs:
            self.result.skipped[component.name] = (
                f"it runs {run.path}, which is the program of {self.programs[run.path][1]}"
            )
        else:
            path = run.path
            self.programs[path] = run, component.name
            made = skeleton(component, self._node(component.name), self.specification.environment)
            self.packages.update(made.packages)
            self.result.files.append(GeneratedFile(path, self._skeleton(made), "component"))
            for parent in path.parents:
                init = parent / "__init__.py"
                if parent != PurePosixPath(".") and all(other.path != init for other in self.result.files):
                    self.result.files.append(GeneratedFile(init, "", "empty"))

    def _node(self, component: str) -> str:
        """The name of a node of the component; the component's name in snake case if it has none."""
        for role in self.specification.roles():
            if self.specification.nodes[role].component == component:
                return role.rpartition("/")[2]
        return snake(component)

    def _skeleton(self, made: Skeleton) -> str:
        template = self.templates.get_template("component.py.j2")
        return template.render(c=made, system=self.specification.name, file=self.file, begin=BEGIN, end=END)

    # -- package files ---------------------------------------------------------------------------------------

    def _package_files(self) -> None:
        system = self.specification.name
        package = snake(system)
        folders = {
            ".".join(parent.parts)
            for run, _ in self.programs.values()
            if run.packaged
            for parent in run.path.parents
            if parent.parts
        }
        context: dict[str, Any] = {
            "system": system,
            "package": package,
            "file": self.file,
            "ros": self.ros,
            "dependencies": sorted(self.packages),
            "packages": sorted(folders),
            "shared": self._installed_files(),
        }
        if self.ros == 2:
            self._add_file("package.xml", "package2.xml.j2", context)
            self._add_file("setup.py", "setup.py.j2", context)
            self._add_file(f"launch/{system}.launch.py", "launch.py.j2", context)
            self.result.files.append(GeneratedFile(PurePosixPath(f"resource/{package}"), "", "empty"))
        else:
            self._add_file("package.xml", "package1.xml.j2", context)
            self._add_file("setup.py", "setup.py.j2", context)
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
        suffix = ".xml" if path.endswith((".xml", ".launch")) else PurePosixPath(path).suffix
        text = self.templates.get_template(template).render(mark="@MARK@", **context)
        before, after = _COMMENT.get(suffix, ("# ", ""))
        self.result.files.append(
            GeneratedFile(PurePosixPath(path), with_mark(text, before, after), "whole", executable)
        )
