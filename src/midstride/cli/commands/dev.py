"""``dev``: run a system, and swap its nodes whenever a file is saved."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path

import click
from rich.console import Console
from rich.text import Text

from midstride.cli.change_options import with_other_nodes_option
from midstride.cli.changed_programs import other_overlay
from midstride.cli.client import Client
from midstride.cli.commands.up import bring_up, missing_lines
from midstride.cli.dev.contents import saves
from midstride.cli.dev.requested_changes import Changes, worst
from midstride.cli.dev.session import DevSession
from midstride.cli.dev.watched_specification import WatchedSpecification
from midstride.cli.input_files import require_file
from midstride.cli.manager_options import backend_option, manager_arguments, platform_options
from midstride.cli.output import console, json_option, print_json, wants_json
from midstride.cli.render import UNKNOWN, seconds, time_of_day
from midstride.cli.shutdown import shut_down
from midstride.cli.specification_argument import absolute, specification_argument
from midstride.cli.staying import ended_by_signals, not_interrupted
from midstride.codec.form import encode
from midstride.errors import SpecificationError
from midstride.runtime.records.reports import Outcome
from midstride.runtime.workspace import Workspace


@click.command("dev")
@specification_argument()
@backend_option("The platform, where the system is not running yet.")
@platform_options(spares=1)
@with_other_nodes_option
@json_option
def dev_command(
    file: Path,
    backend: str,
    use_sim_time: bool,
    no_middleware_settings: bool,
    no_diagnostics: bool,
    spares: int,
    with_other_nodes: bool,
) -> int:
    """Run the system of FILE, and on each save swap exactly the nodes that it changes, without losing a message.

    Watched are FILE, what it includes, its parameter files, and the programs with the modules that they import. Code
    that does not start, raises or stays silent is rejected; the old code keeps running. With --json, each swap is a
    line.

    Ctrl-C, or the end of the terminal, ends a system that this command has started; one that was running goes on.
    """
    arguments = manager_arguments(file, backend, use_sim_time, no_middleware_settings, no_diagnostics, spares)
    require_file(file)
    specification = WatchedSpecification(file)
    workspace = Workspace.of(specification.wanted.name)
    client, screen = Client(workspace.socket), _Screen(console(stderr=wants_json()), wants_json())
    with ended_by_signals() as request:
        started = not client.answers()
        if started:
            workspace.require_room()
            for line in missing_lines(bring_up(client, workspace, arguments)):
                screen.say(line, "red")
        elif use_sim_time or no_middleware_settings or no_diagnostics:
            screen.say(f"{workspace.name} is running already: --use-sim-time and --no-… have no effect")
        changes: Changes | None = None
        try:
            changes = Changes(client, str(absolute(file)), with_other_nodes=with_other_nodes)
            session = DevSession(specification, client, changes.carry_out, screen)
            session.look()
            for line in other_overlay(client.programs()):
                screen.say(line, "yellow")
            ends = "stops the system" if started else "leaves it running"
            state = "up" if started else "attached"
            screen.say(f"{workspace.name} is {state}. Swapping on save; Ctrl-C {ends}.", "green")
            for _ in saves(session.folders):
                if request.came:
                    raise KeyboardInterrupt
                session.look()
        except KeyboardInterrupt:
            if changes is not None and not started:
                for line in changes.interrupted():
                    screen.say(line, "yellow")
        finally:
            if started:
                with not_interrupted():
                    with suppress(OSError):  # the terminal may be closed
                        screen.say(f"Stopping {workspace.name} …", "dim")
                    shut_down(workspace.name)
    return 0


class _Screen:
    """Writes a line for each swap, or with --json a JSON document."""

    def __init__(self, out: Console, json: bool) -> None:
        self._out = out
        self._json = json

    def say(self, words: str, style: str = "default") -> None:
        self._out.print(Text(f"{time_of_day(time.time())} ", style="dim").append(words, style=style))

    def swapped(self, what: str, outcome: Outcome) -> None:
        if self._json:
            print_json({"changed": what, **encode(outcome)}, lines=True)
        else:
            self.say(f"{what}: {_swapped(outcome)}")

    def refused(self, what: str, because: str) -> None:
        if self._json:
            print_json({"changed": what, "outcome": "refused", "because": because}, lines=True)
        else:
            self.say(f"{what}: rejected; the old code keeps running: {because.strip()}", "red")

    def faulty(self, error: SpecificationError) -> None:
        from midstride.cli.error_output import report

        report(error, [])


def _swapped(outcome: Outcome) -> str:
    """``swapped in 410 ms, longest gap 101 ms (1.01 periods), missed 0``"""
    parts = [f"swapped in {seconds(outcome.seconds)}"]
    if swaps := outcome.swaps:
        gap, periods, missed = (worst(swaps, figure) for figure in ("gap", "gap_periods", "missed"))
        parts.append(f"longest gap {seconds(gap)}" + (f" ({periods:.2f} periods)" if periods is not None else ""))
        parts.append(f"missed {UNKNOWN if missed is None else missed}")
    for what, names in (("ended", outcome.unexpected_exits), ("degraded", outcome.unexpected_degradations)):
        if names:
            parts.append(f"{what} unexpectedly: {', '.join(names)}")
    return ", ".join([*parts, *(fault.words for fault in outcome.silences)])
