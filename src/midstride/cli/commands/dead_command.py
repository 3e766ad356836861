"""``dead``: a person knows what the manager cannot know of a host that it does not reach."""

from __future__ import annotations

import click

from midstride.cli import shell_completion
from midstride.cli.output import is_interactive, json_option, show
from midstride.cli.running_systems import find, system_option
from midstride.cli.user_name import user_name


@click.command("dead")
@click.argument("host", shell_complete=shell_completion.hosts)
@click.option("--yes", "-y", is_flag=True, help="Do not ask for confirmation.")
@system_option
@json_option
def dead_command(host: str, yes: bool, system: str | None) -> int:
    """Say that HOST, which cannot be reached, is switched off or destroyed.

    Its nodes then count as crashed, so that they may be started elsewhere, as by `midstride replace NODE --on manager`.
    If they run there all the same, they write beside those, until the manager reaches HOST again, and ends them.
    """
    client, _ = find(system)
    if not yes:
        if not is_interactive():
            raise click.UsageError("not a terminal; pass --yes")
        words = f"Is {host} switched off or destroyed? If its nodes run, they write beside those that take their place."
        if not click.confirm(words, err=True):
            return 1
    dead = client.declare_dead(host, user_name())
    names = ", ".join(dead.instances)
    lines = [f"Host {host} counts as dead{f', and with it {names}' if names else '; nothing ran there'}."]
    lines += [f"`midstride replace {name} --on manager` starts {name} elsewhere." for name in dead.nodes[:1]]
    show(dead, lines)
    return 0
