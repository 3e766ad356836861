"""From the statements of a node's restart policy to the policy, and from its keys to their places in the text."""

from __future__ import annotations

from collections.abc import Sequence

from midstride.lang.declarations import host_of
from midstride.lang.diagnostic_text import Note, Reporter
from midstride.lang.source import Span
from midstride.lang.syntax import Number, RespawnStatement
from midstride.model.respawn import RespawnPolicy

_DEFAULT = RespawnPolicy()
_MOST = _DEFAULT.max_retries or 0


def respawn_policy(statements: Sequence[RespawnStatement], reporter: Reporter) -> RespawnPolicy | None:
    """The policy, if there is one. What is stated twice, or without ``respawn``, is reported."""
    found: dict[str, RespawnStatement] = {}
    for statement in statements:
        word = statement.keyword.text
        if (first := found.setdefault(word, statement)) is not statement:
            note = Note("first stated here", first.span)
            reporter.report("E128", statement.span, f"duplicate `{word}`", help="keep one of them", notes=[note])
    if statements and "respawn" not in found:
        statement = statements[0]
        message = f"`{statement.keyword.text}` has no effect without `respawn`"
        reporter.report("E146", statement.keyword.span, message, help="add `respawn`, or remove it")
    if not statements:
        return None
    delay, retries, fallback = (found.get(f"respawn_{word}") for word in ("delay", "max_retries", "fallback"))
    return RespawnPolicy(
        delay=_value(delay and delay.amount, _DEFAULT.delay),
        max_delay=None if delay is None or delay.bound is None else delay.bound.value,
        max_retries=None if retries and retries.unlimited else int(_value(retries and retries.amount, _MOST)),
        window=_value(retries and retries.bound, _DEFAULT.window),
        fallback=None if fallback is None or fallback.component is None else fallback.component.text,
        fallback_host=None if fallback is None or fallback.host is None else host_of(fallback.host),
        lease=None if fallback is None or fallback.amount is None else fallback.amount.value,
    )


def _value(number: Number | None, default: float) -> float:
    return default if number is None else number.value


def respawn_span(statements: Sequence[RespawnStatement], path: Sequence[str]) -> Span:
    """The place of a key of the policy in the JSON form (``delay_seconds``), or of `respawn` itself."""
    by_word = {statement.keyword.text: statement for statement in reversed(statements)}
    delay, retries, fallback = (by_word.get(f"respawn_{word}") for word in ("delay", "max_retries", "fallback"))
    places = {
        "delay_seconds": delay and delay.amount,
        "max_delay_seconds": delay and delay.bound,
        "max_retries": retries and retries.amount,
        "window_seconds": retries and retries.bound,
        "fallback": fallback and fallback.component,
        "fallback_host": fallback and (fallback.host or fallback.component),
        "lease_seconds": fallback and (fallback.amount or fallback.host),
    }
    place = places.get(path[0]) if path else None
    return by_word.get("respawn", statements[0]).keyword.span if place is None else place.span
