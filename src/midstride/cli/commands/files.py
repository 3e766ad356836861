"""``export``: a specification as JSON."""

from __future__ import annotations

from pathlib import Path

import click

from midstride.cli.output import json_option, print_json
from midstride.cli.systems import find, system_option


@click.command("export")
@click.argument("file", required=False, type=click.Path(path_type=Path))
@click.option("--schema", is_flag=True, help="Print the JSON Schema of specifications instead.")
@system_option
@json_option
def export_command(file: Path | None, schema: bool, system: str | None) -> int:
    """Print the specification in FILE, or that of the running system, as JSON."""
    if schema:
        from midstride.codec.schema import specification_schema

        print_json(specification_schema())
        return 0
    if file is not None:
        from midstride.cli.files import read
        from midstride.codec.specification import encode_specification

        print_json(encode_specification(read(file)))
        return 0
    client, _ = find(system)
    print_json(client.get("/specification"))
    return 0
