"""Forms as JSON: what UTF-8 cannot express is escaped, all else is as msgspec writes it."""

from __future__ import annotations

import os
from typing import Any

import msgspec
import pytest

from midstride.codec.writing import to_json

PATH = os.fsdecode(b"/robots/f\xfcnf")


class Found(msgspec.Struct):
    path: str
    values: dict[str, Any]
    state: bytes = b""


@pytest.mark.parametrize("value", ["ü", {"a": [1, 2.5, None, True]}, Found("\N{ROBOT FACE}", {}, b"\0\xff")])
def test_all_else_is_as_msgspec_writes_it(value: object) -> None:
    assert to_json(value) == msgspec.json.encode(value)


def test_lone_surrogates_are_escaped_wherever_they_are() -> None:
    found = msgspec.json.decode(to_json(Found(PATH, {PATH: [1, PATH]}, b"\xfc")), type=Found)
    escaped = r"/robots/f\udcfcnf"
    assert found == Found(escaped, {escaped: [1, escaped]}, b"\xfc")


def test_what_msgspec_cannot_write_is_refused() -> None:
    with pytest.raises(TypeError):
        to_json({PATH: object()})
