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
        from midstride.lang.schema import schema as schema_of_specifications

        print_json(schema_of_specifications())
        return 0
    if file is not None:
        from midstride.cli.files import read
        from midstride.model.document import specification_to_document

        print_json(specification_to_document(read(file)))
        return 0
    client, _ = find(system)
    print_json(client.get("/specification"))
    return 0
