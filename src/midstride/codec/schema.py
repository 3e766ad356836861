"""JSON Schema (draft 2020-12) from the forms.

It states the form: keys, types of values, ranges, shapes of names. That names are declared and contracts satisfied no
schema can state: `midstride check` judges that.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeAlias

import msgspec

from midstride.codec.form import LARGEST, ShapedForm
from midstride.codec.specification_form import SpecificationForm

Schema: TypeAlias = dict[str, Any]


def specification_schema() -> Schema:
    """The schema of a whole specification."""
    definitions = schemas([SpecificationForm], "#/$defs/{name}")
    whole = definitions.pop(SpecificationForm.__name__)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **whole,
        "title": "Midstride specification",
        "$defs": definitions,
    }


def schemas(forms: Iterable[Any], template: str) -> dict[str, Schema]:
    """The schemas of the forms and of all that they are made of, by class name; ``template`` refers to one."""
    _, found = msgspec.json.schema_components(forms, ref_template=template)
    for form in ShapedForm.__subclasses__():
        if form.__name__ in found:
            found[form.__name__] = _shaped(found[form.__name__], form)
    return {name: _cleaned(schema) for name, schema in found.items()}


def _shaped(schema: Schema, form: type[ShapedForm]) -> Schema:
    """One object for each shape, instead of one in which every key is optional."""
    properties = schema["properties"]
    shapes = [
        {
            "type": "object",
            "properties": {name: properties[name] for name in (*shape.required, *shape.optional)},
            "required": list(shape.required),
            "additionalProperties": False,
        }
        for shape in form.all_shapes()
    ]
    return {"title": schema["title"], "description": schema["description"], "anyOf": shapes}


def _cleaned(value: Any) -> Any:
    """Without what only makes a number finite, without defaults that are empty, and unions of plain types short."""
    if isinstance(value, list):
        return [_cleaned(item) for item in value]
    if not isinstance(value, dict):
        return value
    cleaned = {
        key: _cleaned(entry)
        for key, entry in value.items()
        if not (key in {"minimum", "maximum"} and entry in {LARGEST, -LARGEST})
        and not (key in {"default", "required"} and entry in ([], {}))
    }
    members = cleaned.get("anyOf", [])
    if members and all(list(member) == ["type"] for member in members):
        del cleaned["anyOf"]
        types = [member["type"] for member in members]
        types = [name for name in types if name != "integer" or "number" not in types]
        cleaned["type"] = types if len(types) > 1 else types[0]
    return cleaned
