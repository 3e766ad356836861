"""The examples, for the tests: each system also in its JSON form, which a test may change."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from midstride.codec.specification_form import encode_specification
from midstride.lang import load

EXAMPLES: Final = Path(__file__).parents[2] / "examples"


def json_form(name: str) -> dict[str, Any]:
    """The document that `midstride export` prints for an example."""
    return encode_specification(load(EXAMPLES / name / f"{name}.stride").require())


def json_text(name: str) -> str:
    return json.dumps(json_form(name), indent=2)
