"""Writing forms as JSON."""

from __future__ import annotations

from typing import Any

import msgspec


def to_json(form: object) -> bytes:
    """``form`` as JSON. Raises as msgspec does, but for what UTF-8 cannot express.

    Paths may have it: a byte that is not UTF-8 is a lone surrogate in Python, and is written as ``\\udcff`` here.
    """
    try:
        return msgspec.json.encode(form)
    except UnicodeEncodeError:
        return msgspec.json.encode(_expressible(msgspec.to_builtins(form)))


def expressible(text: str) -> str:
    """``text`` with each lone surrogate as an escape, as in ``\\udcff``."""
    return text if text.isascii() else text.encode("utf-8", "backslashreplace").decode()


def _expressible(value: Any) -> Any:
    if isinstance(value, str):
        return expressible(value)
    if isinstance(value, dict):
        return {_expressible(key): _expressible(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_expressible(each) for each in value]
    return value
