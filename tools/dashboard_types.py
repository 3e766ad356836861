"""TypeScript declarations of the API's forms, by which `tools/check-dashboard` checks the dashboard's modules.

`make reference` writes them, from the schemas of the OpenAPI document and of a report's data: the modules name them as
`Api.…` in their comments. A field is optional where the manager may leave it out, or a request may.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any, Final

import msgspec

from midstride.codec.form import Form
from midstride.codec.schema import Schema, schemas
from midstride.server.openapi import FORMS
from midstride.server.report.documents import ReportDocument

_PLAIN: Final = {
    "string": "string",
    "number": "number",
    "integer": "number",
    "boolean": "boolean",
    "null": "null",
    "array": "unknown[]",
    "object": "Record<string, unknown>",
}
_HEAD: Final = """\
// The forms of the HTTP API (docs/http.md), for the checker of the dashboard's modules.
// `make reference` writes this file from midstride.server.openapi.

declare namespace Api {
"""


def declarations() -> str:
    """The whole file."""
    forms = {form.__name__: form for form in _subclasses(Form)}
    found = schemas((*FORMS, ReportDocument), "{name}")
    return _HEAD + "\n".join(_declaration(name, found[name], forms.get(name)) for name in sorted(found)) + "}\n"


def _subclasses(form: type[Form]) -> Iterator[type[Form]]:
    for each in form.__subclasses__():
        yield each
        yield from _subclasses(each)


def _declaration(name: str, schema: Schema, form: type[Form] | None) -> str:
    comment = _comment(schema.get("description", ""), "  ")
    if "properties" not in schema:
        return f"{comment}  type {name} = {_type(schema)};\n"
    always = set(schema.get("required", ()))
    if form is not None and not form.__struct_config__.omit_defaults:  # every field is written but what is unset
        always |= {each.encode_name for each in msgspec.structs.fields(form) if each.default is not msgspec.UNSET}
        if form.__struct_config__.tag_field is not None:
            always.add(form.__struct_config__.tag_field)
    return f"{comment}  interface {name} {{\n{_members(schema, always, '    ')}  }}\n"


def _members(schema: Schema, always: set[str], indent: str) -> str:
    lines = []
    for name, each in schema["properties"].items():
        key = name if re.fullmatch(r"[A-Za-z_]\w*", name) else json.dumps(name)
        lines.append(_comment(each.get("description", ""), indent))
        lines.append(f"{indent}{key}{'' if name in always else '?'}: {_type(each)};\n")
    return "".join(lines)


def _comment(text: str, indent: str) -> str:
    text = " ".join(text.split())
    return f"{indent}/** {text} */\n" if text else ""


def _type(schema: Any) -> str:
    """The type of the values that ``schema`` describes. Ranges, patterns and lengths are beyond a type."""
    match schema:
        case {"$ref": name}:
            return str(name)
        case {"enum": values}:
            return " | ".join(json.dumps(value) for value in values)
        case {"anyOf": members}:
            return " | ".join(dict.fromkeys(map(_type, members)))
        case {"type": "array", "prefixItems": items}:
            return f"[{', '.join(map(_type, items))}]"
        case {"type": "array"}:
            item = _type(schema.get("items", {}))
            return f"({item})[]" if "|" in item else f"{item}[]"
        case {"type": "object", "properties": _}:
            members = _members(schema, set(schema.get("required", ())), "").replace("\n", " ")
            return f"{{ {members}}}"
        case {"type": "object"}:
            return f"Record<string, {_type(schema.get('additionalProperties', {}))}>"
        case {"type": list(names)}:
            return " | ".join(dict.fromkeys(_PLAIN[name] for name in names))
        case {"type": str(name)}:
            return _PLAIN[name]
    return "unknown"
