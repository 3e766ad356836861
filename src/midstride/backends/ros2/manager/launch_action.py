"""The action of :mod:`midstride.launch`: a process of `midstride up` that lives as long as the launch."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any, Final

from launch.actions import ExecuteProcess
from launch.frontend import expose_action

# How long the system may take to end before the launch sends more than SIGINT (s).
STOPPING: Final = "30"


@expose_action("midstride")
class BringUpSystem(ExecuteProcess):  # type: ignore[misc]  # launch has no types
    """Brings a specification up when it is visited, and stops the system when the launch shuts down.

    ``specification`` is the path of a `.stride` or `.json` file, and ``arguments`` are further ones of `midstride up`,
    such as ``["--use-sim-time"]``; all may have substitutions. The other arguments are those of `ExecuteProcess`: with
    ``on_exit=[Shutdown()]``, for one, the launch ends if the system cannot be brought up.
    """

    def __init__(
        self, *, specification: Any, backend: Any = "ros2", arguments: Iterable[Any] = (), **process: Any
    ) -> None:
        command = [sys.executable, "-m", "midstride", "up", specification, "--backend", backend, "--stop-on-exit"]
        options = {"name": "midstride", "output": "screen", "sigterm_timeout": STOPPING, **process}
        super().__init__(cmd=[*command, *arguments], **options)

    @classmethod
    def parse(cls, entity: Any, parser: Any) -> tuple[type[BringUpSystem], dict[str, Any]]:
        """The element `midstride` of launch files in XML and YAML: `specification`, `backend`, `args`."""
        _, options = super().parse(entity, parser, ignore=["cmd"])
        options["specification"] = parser.parse_substitution(entity.get_attr("specification"))
        if (backend := entity.get_attr("backend", optional=True)) is not None:
            options["backend"] = parser.parse_substitution(backend)
        if (arguments := entity.get_attr("args", optional=True)) is not None:
            options["arguments"] = cls._parse_cmdline(arguments, parser)
        return cls, options
