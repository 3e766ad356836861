"""What the JSON forms cost with msgspec and with pydantic: importing the library, making the classes, reading, memory.

The pydantic models are made from the msgspec classes, field by field with the same constraints, so both read the same
document: a specification of ``--nodes`` nodes. Each figure is from processes of their own.
"""

from __future__ import annotations

import argparse
import importlib
import json
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any, Literal

RUNS = 7


def document(nodes: int) -> bytes:
    """A chain of nodes of different components, each with an input and an output."""
    text = {"type": "std_msgs/msg/String", "rate": 10, "qos": {"depth": 5}, "where": {"data": {"in": ["a", "b"]}}}
    mode = {"assumes": ["in"], "guarantees": {"out": text}}
    work = {"uses": ["in"], "produces": ["out"], "modes": {"normal": mode, "degraded": {}}}
    body = {
        "run": "python3 -m x",
        "parameters": {"gain": {"value": 0.5, "changeable": True}},
        "inputs": {"in": text},
        "outputs": ["out"],
        "functionalities": {"work": work},
    }
    attached = {index: {"in": [f"/t{index}"], "out": [f"/t{index + 1}"]} for index in range(nodes)}
    whole = {
        "system": "large",
        "topics": {f"/t{index}": text for index in range(nodes + 1)},
        "components": {f"C{index}": body for index in range(nodes)},
        "nodes": {f"n{index}": {"component": f"C{index}", "attachments": attached[index]} for index in range(nodes)},
    }
    return json.dumps(whole).encode()


def import_only(library: str) -> dict[str, float]:
    begun = time.perf_counter()
    if library == "msgspec":
        importlib.import_module("msgspec")
    else:
        importlib.import_module("pydantic").BaseModel  # noqa: B018  # loaded when it is named
    return {"import": time.perf_counter() - begun}


def read(library: str, nodes: int) -> dict[str, float]:
    """Seconds to make a reader for the forms and to read, and the memory that the value takes (MiB)."""
    from midstride.codec.specification_form import SpecificationForm

    text = document(nodes)
    begun = time.perf_counter()
    decode = msgspec_reader(SpecificationForm) if library == "msgspec" else pydantic_reader(SpecificationForm)
    decode(b'{"system": "s"}')
    made = time.perf_counter()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    value = decode(text)
    first = time.perf_counter()
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert value is not None
    return {"classes": made - begun, "read": first - made, "memory": (after - before) / 1024}


def msgspec_reader(form: Any) -> Callable[[bytes], Any]:
    import msgspec

    return msgspec.json.Decoder(form).decode


def pydantic_reader(form: Any) -> Callable[[bytes], Any]:
    from msgspec import inspect

    model: Any = _model(inspect.type_info(form), {})
    return lambda text: model.model_validate_json(text, strict=True)


def _model(type_: Any, made: dict[Any, Any]) -> Any:
    """The pydantic counterpart of a type of msgspec."""
    import functools
    import operator
    from typing import Annotated

    from msgspec import inspect
    from pydantic import ConfigDict, Field, create_model

    constraints = {
        to: value
        for to in ("gt", "ge", "lt", "le", "min_length", "max_length")
        if (value := getattr(type_, to, None)) is not None
    }
    if isinstance(type_, inspect.Metadata):
        return _model(type_.type, made)
    if isinstance(type_, inspect.StructType):
        if type_.cls not in made:
            fields: dict[str, Any] = {
                field.name: (
                    _model(field.type, made) if field.required else _model(field.type, made) | None,
                    Field(... if field.required else None, alias=field.encode_name),
                )
                for field in type_.fields
            }
            config = ConfigDict(extra="forbid", frozen=True)
            made[type_.cls] = create_model(type_.cls.__name__, __config__=config, **fields)
        return made[type_.cls]
    if isinstance(type_, inspect.DictType):
        return dict[str, _model(type_.value_type, made)]  # type: ignore[misc]
    if isinstance(type_, inspect.ListType):
        return list[_model(type_.item_type, made)]  # type: ignore[misc]
    if isinstance(type_, inspect.UnionType):
        return functools.reduce(operator.or_, (_model(member, made) for member in type_.types))
    if isinstance(type_, inspect.LiteralType):
        return Literal[type_.values]
    plains: dict[Any, Any] = {
        inspect.StrType: str,
        inspect.IntType: int,
        inspect.FloatType: float,
        inspect.BoolType: bool,
    }
    plain = plains[type(type_)]
    return Annotated[plain, Field(**constraints)] if constraints else plain


def measured(library: str, nodes: int) -> dict[str, float]:
    """The medians of several processes."""
    found: dict[str, list[float]] = {}
    for part in ("import", "read"):
        for _ in range(RUNS):
            line = [sys.executable, __file__, "--part", part, "--library", library, "--nodes", str(nodes)]
            for name, value in json.loads(subprocess.run(line, check=True, capture_output=True).stdout).items():
                found.setdefault(name, []).append(value)
    return {name: statistics.median(values) for name, values in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--nodes", type=int, default=1000)
    parser.add_argument("--json", metavar="FILE", help="write the figures as JSON")
    parser.add_argument("--part", choices=("import", "read"), help=argparse.SUPPRESS)
    parser.add_argument("--library", choices=("msgspec", "pydantic"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.part:
        part = import_only(options.library) if options.part == "import" else read(options.library, options.nodes)
        print(json.dumps(part))
        return
    found = {library: measured(library, options.nodes) for library in ("msgspec", "pydantic")}
    print(f"{'':10}{'import':>10}{'classes':>10}{f'read {options.nodes} nodes':>18}{'memory':>12}")
    for library, row in found.items():
        times = f"{row['import'] * 1000:>7.0f} ms{row['classes'] * 1000:>7.0f} ms{row['read'] * 1000:>15.1f} ms"
        print(f"{library:10}{times}{row['memory']:>8.1f} MiB")
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump(found, file, indent=2)


if __name__ == "__main__":
    main()
