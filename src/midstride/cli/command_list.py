"""The commands under their headings; each is imported when it is called."""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Final

import click

from midstride.cli.output import json_option

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

# heading -> command -> (module of midstride.cli.commands, what it does)
GROUPS: Final[dict[str, dict[str, tuple[str, str]]]] = {
    "Design time": {
        "check": ("check_commands", "check specifications"),
        "fmt": ("check_commands", "format specifications"),
        "explain": ("check_commands", "explain a diagnostic code"),
        "graph": ("design", "draw components and their connections"),
        "impact": ("design", "show what degrades if a node is removed or crashes"),
        "diff": ("design", "compare two specifications"),
        "plan": ("plan_command", "plan a change: its steps, what it disrupts and why"),
        "simulate": ("simulate", "rehearse a change in virtual time while faults strike"),
        "verify": ("verify", "verify a specification, a plan or the running system with Alloy"),
        "prove": ("prove", "prove that every action is safe, for systems of any size"),
        "generate": ("generate", "generate node skeletons, launch and package files"),
        "export": ("design", "print a specification as JSON"),
        "import": ("import_command", "write a specification of what a launch file starts"),
        "capture": ("capture", "add the ports of running ROS 2 nodes to a specification"),
    },
    "Running system": {
        "up": ("up", "start a system and its manager, and watch it"),
        "status": ("running", "show nodes, modes and topics"),
        "why": ("running", "explain why a functionality is in its mode"),
        "dev": ("dev", "run a system, and swap its nodes whenever a file is saved"),
        "logs": ("logs_command", "show what a node's component has written"),
        "log": ("running", "show the latest events"),
        "history": ("history_commands", "show the changes of a system, with their figures"),
        "report": ("report", "write a change of the history as one HTML file"),
        "watch": ("running", "watch the system live"),
        "dashboard": ("dashboard", "show the system and its changes on a live page"),
        "lock": ("lock_commands", "refuse every change until the system is unlocked"),
        "unlock": ("lock_commands", "end a lock"),
        "dead": ("dead_command", "say that a host which cannot be reached is dead"),
        "down": ("running", "stop all components and the manager"),
    },
    "Changes to the running system": {
        "replace": ("change_commands", "replace a node's component"),
        "restart": ("change_commands", "restart nodes with the code now on disk"),
        "add": ("change_commands", "add a node"),
        "remove": ("change_commands", "remove nodes"),
        "apply": ("change_commands", "change the system to another specification"),
        "rollback": ("history_commands", "go back to an earlier specification"),
        "param": ("param", "show and set parameters of running nodes"),
    },
    "Tools": {
        "demo": ("demo", "run an example from start to finish"),
        "systemd": ("systemd", "print a unit with which systemd keeps a system up"),
        "lsp": ("lsp_command", "run the language server for editors"),
    },
}
COMMANDS: Final = {name: entry for commands in GROUPS.values() for name, entry in commands.items()}
# What other processes call: command -> (module of midstride.cli.commands, its function).
HIDDEN: Final = {
    "_manager": ("manage", "manager_command"),
    "host": ("host_process", "host_command"),
    "_host": ("host_process", "serving_command"),
}


class WithoutCommand(click.UsageError):
    """A group was called without a command; its help is the message. Click has such an error from 8.2 on."""

    def __init__(self, ctx: click.Context) -> None:
        super().__init__(ctx.get_help(), ctx)


class Group(click.Group):
    """A group that answers an unknown command with the one that was probably meant, and none with its help."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not args and self.no_args_is_help and not ctx.resilient_parsing:
            raise WithoutCommand(ctx)
        return super().parse_args(ctx, args)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if not (name.startswith("-") or ctx.resilient_parsing) and self.get_command(ctx, name) is None:
            from midstride.model.diagnostics import suggestion

            raise click.UsageError(f"there is no command `{name}`; {suggestion(name, self.list_commands(ctx))}", ctx)
        return super().resolve_command(ctx, args)


class Commands(Group):
    """The group of all commands: it lists them by name and imports only the one that is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name in COMMANDS:
            module, function = COMMANDS[name][0], f"{name}_command"
        elif name in HIDDEN:
            module, function = HIDDEN[name]
        else:
            return None
        command = getattr(importlib.import_module(f"midstride.cli.commands.{module}"), function)
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        width = max(map(len, COMMANDS))
        for heading, commands in GROUPS.items():
            with formatter.section(heading):
                formatter.write_dl([(name.ljust(width), summary) for name, (_, summary) in commands.items()])

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem[str]]:
        """Click's own version imports every command for its help text."""
        from click.shell_completion import CompletionItem

        commands = [CompletionItem(name, help=COMMANDS[name][1]) for name in COMMANDS if name.startswith(incomplete)]
        return commands + click.Command.shell_complete(self, ctx, incomplete)


def _print_version(ctx: click.Context, _: click.Parameter, value: bool) -> None:
    if value and not ctx.resilient_parsing:
        from midstride import __version__  # read from the metadata of what is installed

        click.echo(f"midstride {__version__}")
        ctx.exit()


# With `color`, click leaves control sequences to the output, which escapes them.
@click.command(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "color": True})
@json_option
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_print_version, help="Print the version."
)
@click.option(
    "--include-path", multiple=True, metavar="DIR", help="Specifications may include files from below DIR, too."
)
def cli(include_path: tuple[str, ...]) -> None:
    """Replace the components of a running ROS system while losing as little functionality as possible.

    Exit status: 0 yes, or done; 1 no, with the reason; 2 wrong usage; 130 interrupted (Ctrl-C).
    """
    if include_path:
        from midstride.lang.source_files import INCLUDE_PATH

        # In the environment, so that it holds in a manager that this command starts.
        os.environ[INCLUDE_PATH] = os.pathsep.join([*include_path, os.environ.get(INCLUDE_PATH, "")])
