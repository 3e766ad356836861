"""The parameter file that a process without Midstride's API is started with.

A parameter file and not `-p`: it takes any name and any text, and it reaches one node of several in a process. rcl goes
through the sections of a file in their order, and the last one that matches a node wins; so that of the node itself,
which has what counts for it, comes last.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Final

from midstride.errors import BackendError
from midstride.model.component import ParameterSection
from midstride.model.instance_names import dotted_name

FOLDER: Final = "parameters"
# The section of all nodes.
ALL: Final = "/**"
# libyaml takes a longer key only after a question mark.
_SIMPLE_KEY: Final = 200
# Of a smaller number, rcl reads only the hexadecimal form as one.
_SMALLEST: Final = 2.0**-1022


def parameter_file(folder: Path, instance: str) -> Path:
    """The parameter file of an instance; ``folder`` has what is known of its process."""
    return folder / FOLDER / f"{dotted_name(instance)}.yaml"


def write_parameters(path: Path, sections: Iterable[ParameterSection], node: str, values: Mapping[str, object]) -> bool:
    """Write the file, readable by this user alone; whether there is anything to write.

    ``values``: of the node with the full name ``node``; ``sections``: of further nodes in its process. Raises
    BackendError.
    """
    text = parameters_text(sections, node, values)
    if not text:
        return False
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise BackendError(f"{path} cannot be written: {error.strerror or error}") from None
    return True


def parameters_text(sections: Iterable[ParameterSection], node: str, values: Mapping[str, object]) -> str:
    """Return what :func:`write_parameters` writes; empty where there are none."""
    return "".join(_lines(sections, node, values))


def _lines(sections: Iterable[ParameterSection], node: str, values: Mapping[str, object]) -> Iterator[str]:
    for section in (*sections, ParameterSection(node, values)):  # type: ignore[arg-type]
        replaced = section.pattern.strip("/") == node.strip("/") and node != ALL and section.parameters is not values
        if section.parameters and not replaced:
            yield f"{_in_yaml(section.pattern)}:\n  ros__parameters:\n"
            for name, value in sorted(section.parameters.items()):
                key = _in_yaml(name)
                yield f"    {key}: " if len(key) < _SIMPLE_KEY else f"    ? {key}\n    : "
                yield f"{_in_yaml(value)}\n"


def _in_yaml(value: object) -> str:
    """``value`` as rcl reads it. A text is as in JSON, but for the escapes of characters beyond U+FFFF."""
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_in_yaml, value))}]"
    if isinstance(value, float):
        if not math.isfinite(value):
            return ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"
        return value.hex() if 0 < abs(value) < _SMALLEST else repr(value)
    text = json.dumps(value, ensure_ascii=False)
    return "".join(each if each.isascii() and each.isprintable() else f"\\U{ord(each):08x}" for each in text)
