"""The options of `up` that are its manager's, and the arguments that say the same to another process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import wraps
from pathlib import Path
from typing import Any, Final

import click

from midstride.backends import NAMES
from midstride.cli.specification_argument import absolute

MOST_SPARES: Final = 20


def backend_option(help: str) -> Callable[[Callable[..., int]], Callable[..., int]]:
    return click.option(
        "--backend",
        type=click.Choice(NAMES),
        default="ros2",
        show_default=True,
        envvar="MIDSTRIDE_BACKEND",
        show_envvar=True,
        help=help,
    )


def platform_options(spares: int) -> Callable[[Callable[..., int]], Callable[..., int]]:
    """The options that hold for every process of the system: the last arguments of :func:`manager_arguments`.

    ``spares`` is how many spare processes there are by default.
    """
    sim_time = click.option(
        "--use-sim-time",
        is_flag=True,
        help="Have /clock drive every node that does not set use_sim_time itself, also those added later (ROS 2).",
    )
    no_settings = click.option(
        "--no-middleware-settings",
        is_flag=True,
        help="Leave transports and discovery of the middleware as they are; see docs/how-to/middleware-settings.md.",
    )
    no_diagnostics = click.option(
        "--no-diagnostics", is_flag=True, help="Do not publish on /diagnostics; see docs/how-to/diagnostics.md."
    )
    kept = click.option(
        "--spares",
        type=click.IntRange(0, MOST_SPARES),
        default=spares,
        show_default=True,
        metavar="N",
        help="Keep N processes ready that have loaded ROS, so that components start sooner; see docs/how-to/spares.md.",
    )
    return lambda function: sim_time(no_settings(no_diagnostics(kept(function))))


def manager_arguments(
    file: Path, backend: str, use_sim_time: bool, no_middleware_settings: bool, no_diagnostics: bool, spares: int
) -> list[str]:
    """The arguments of a manager for the system of ``file``. Raises UsageError for what the back end does not have."""
    if use_sim_time and backend != "ros2":
        raise click.UsageError(
            "--use-sim-time is for ROS 2; on ROS 1, `rosparam set use_sim_time true` before `up` does it for every node"
        )
    options = ["--use-sim-time"] * use_sim_time + ["--no-middleware-settings"] * no_middleware_settings
    options += [*["--no-diagnostics"] * no_diagnostics, "--spares", str(spares)]
    return [str(absolute(file)), "--backend", backend, *options]


@dataclass(frozen=True, slots=True)
class ManagerOptions:
    """The options of a manager, as they were given to a command."""

    backend: str
    http: int | None
    http_host: str | None
    metrics_file: Path | None
    use_sim_time: bool
    no_middleware_settings: bool
    no_diagnostics: bool
    spares: int
    finish_interrupted: bool
    keep_degraded: bool
    strict: bool

    def arguments(self, file: Path) -> list[str]:
        """The arguments of a manager for the system of ``file``, which `up` takes as well.

        Raises UsageError for what the back end does not have, or what does not go together.
        """
        if self.http_host is not None and self.http is None:
            raise click.UsageError("--http-host needs --http PORT")
        arguments = manager_arguments(
            file, self.backend, self.use_sim_time, self.no_middleware_settings, self.no_diagnostics, self.spares
        )
        if self.http is not None:
            arguments += ["--http", str(self.http), *(["--http-host", self.http_host] if self.http_host else [])]
        arguments += ["--finish-interrupted"] * self.finish_interrupted + ["--keep-degraded"] * self.keep_degraded
        arguments += ["--strict"] * self.strict
        if self.metrics_file is not None:
            arguments += ["--metrics-file", str(self.metrics_file.absolute())]
        return arguments


_OPTIONS: Final = (
    backend_option("The platform."),
    click.option(
        "--http",
        type=click.IntRange(1, 65535),
        metavar="PORT",
        help="Serve the HTTP API on a TCP port of the loopback address as well; see docs/http.md.",
    ),
    click.option("--http-host", metavar="ADDRESS", help="With --http: listen on this address instead."),
    click.option(
        "--metrics-file",
        type=click.Path(path_type=Path, dir_okay=False),
        metavar="PATH",
        help="Keep metrics in this file for node_exporter's textfile collector; see docs/how-to/monitoring.md.",
    ),
    platform_options(spares=0),
    click.option(
        "--finish-interrupted",
        is_flag=True,
        help="Finish a change that was interrupted because the manager was killed, instead of rolling it back.",
    ),
    click.option(
        "--keep-degraded",
        is_flag=True,
        help="Do not restore what has degraded because an input failed: a command does.",
    ),
    click.option(
        "--strict",
        is_flag=True,
        help="Start all nodes or none: if one of them cannot be started, stop the others.",
    ),
)


def manager_options(function: Callable[..., int]) -> Callable[..., int]:
    """The options of a manager, which ``function`` receives together, as ``options``."""
    names = [each.name for each in fields(ManagerOptions)]

    @wraps(function)
    def together(*arguments: Any, **values: Any) -> int:
        return function(*arguments, options=ManagerOptions(**{name: values.pop(name) for name in names}), **values)

    decorated: Callable[..., int] = together
    for option in reversed(_OPTIONS):
        decorated = option(decorated)
    return decorated
