"""The commands, by name; each is imported when it is called."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any, Final

import click

from midstride import __version__

# name -> (module of midstride.cli.commands, what it does)
COMMANDS: Final[dict[str, tuple[str, str]]] = {
    "check": ("check", "check specifications at design time"),
    "fmt": ("check", "bring specifications into canonical form"),
    "explain": ("check", "say what a diagnostic means"),
    "graph": ("design", "draw components and what connects them"),
    "impact": ("design", "what falls if a node is removed or crashes"),
    "diff": ("design", "how two specifications differ"),
    "generate": ("generate", "skeletons of the nodes, launch and package files"),
    "lsp": ("lsp", "the language server, for editors"),
    "plan": ("plan", "show the plan for a change, what it disrupts and why"),
    "verify": ("verify", "have Alloy judge a specification, a plan or what is running"),
    "prove": ("prove", "prove that every action is safe, for systems of any size"),
    "export": ("files", "print a specification as JSON"),
    "up": ("up", "start a system and its manager, and watch it"),
    "status": ("running", "what is live, in which modes"),
    "why": ("running", "why a functionality is in the mode it is in"),
    "log": ("running", "what has happened"),
    "watch": ("running", "watch it happen; the system does not depend on it"),
    "replace": ("change", "replace a node's component"),
    "add": ("change", "add a node"),
    "remove": ("change", "remove nodes"),
    "apply": ("change", "change the running system to another specification"),
    "down": ("running", "end a system: every component, and its manager"),
    "demo": ("demo", "run an example from beginning to end"),
}
HIDDEN: Final[dict[str, str]] = {"_manager": "manage"}


@dataclass(slots=True)
class Settings:
    """What holds for the whole command line."""

    json: bool = False


class Commands(click.Group):
    """A group that knows its commands by name and imports the one that is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        module = COMMANDS[name][0] if name in COMMANDS else HIDDEN.get(name)
        if module is None:
            return None
        found = importlib.import_module(f"midstride.cli.commands.{module}")
        command = getattr(found, name.strip("_") + "_command")
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, told) for name, (_, told) in COMMANDS.items()])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if not name.startswith("-") and self.get_command(ctx, name) is None:
            from midstride.model.diagnostics import suggestion

            raise click.UsageError(f"there is no command `{name}`; {suggestion(name, COMMANDS)}", ctx)
        return super().resolve_command(ctx, args)


def _set_json(ctx: click.Context, _: click.Parameter, value: bool) -> None:
    settings = ctx.ensure_object(Settings)
    settings.json = settings.json or value


def json_option(function: Any) -> Any:
    """``--json``, which may stand anywhere on the line."""
    told = "Print one JSON document, and nothing else."
    return click.option("--json", is_flag=True, expose_value=False, callback=_set_json, help=told)(function)


def _print_version(ctx: click.Context, _: click.Parameter, value: bool) -> None:
    if value:
        click.echo(f"midstride {__version__}")
        ctx.exit()


@click.command(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@json_option
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_print_version, help="The version."
)
def cli() -> None:
    """Replace the components of a running ROS system, with the least functionality lost on the way.

    Exit status: 0 the answer is yes, or done; 1 the answer is no, with the reason; 2 wrong usage.
    """
