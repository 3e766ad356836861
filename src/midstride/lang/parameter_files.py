"""ROS parameter files: their sections, and which nodes each section applies to.

The layout is that of ROS 2: a section is named after a node, with its namespace as a prefix or as enclosing sections,
or with wildcards (``/**``, ``/*/camera``), and contains ``ros__parameters``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from midstride.lang.diagnostic_text import Reporter
from midstride.lang.rcl_parameters import ParameterValueAt, RclParameters
from midstride.lang.source import Source, Span
from midstride.lang.yaml_events import InvalidYaml
from midstride.model.component import ParameterSection


@dataclass(frozen=True, slots=True)
class SectionInFile:
    """A section of parameter files: its name, and the values of the nodes that it applies to, by dotted name."""

    pattern: str
    span: Span
    values: Mapping[str, ParameterValueAt]

    def matches(self, role: str) -> bool:
        """Return whether the section applies to the node ``role``, as in ROS."""
        return ParameterSection(self.pattern).matches(role)


def read_sections(source: Source, reporter: Reporter) -> list[SectionInFile] | None:
    """The sections of a parameter file; None if rcl takes no such file, which is reported."""
    try:
        return sections_of([source])
    except InvalidYaml as refused:
        reporter.report("E150", refused.span, str(refused), help=refused.help)
        return None


def sections_of(sources: Sequence[Source]) -> list[SectionInFile]:
    """The sections of several files as rcl has them after it has read one after the other. Raises InvalidYaml."""
    parameters = RclParameters()
    for source in sources:
        parameters.read(source)
    return [SectionInFile(pattern, span, values) for pattern, span, values in parameters.sections()]
