"""YAML as PyYAML's events, with their places in the text."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from midstride.lang.source import Source, Span


class InvalidYaml(Exception):
    """The text at ``span`` is not valid YAML, or not what is expected there."""

    def __init__(self, span: Span, message: str, help: str | None = None) -> None:
        super().__init__(message)
        self.span = span
        self.help = help


def events(source: Source) -> Iterator[Any]:
    """PyYAML's events. Raises InvalidYaml where the text is not YAML."""
    import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        yield from yaml.parse(source.text, Loader=loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        reason = error.problem or error.context or "it cannot be parsed"
        offset = 0 if mark is None else source.offset(mark.line + 1, mark.column + 1)
        message = f"invalid YAML: {reason}"
        raise InvalidYaml(Span(source, offset, offset), message, "indent with spaces, not tabs") from None
    except (yaml.YAMLError, UnicodeEncodeError):  # a character that no YAML contains, or a lone surrogate
        match = yaml.reader.Reader.NON_PRINTABLE.search(source.text)
        start, end = match.span() if match else (0, 0)
        message = f"invalid YAML: it contains {source.text[start:end]!a}" if match else "invalid YAML"
        raise InvalidYaml(Span(source, start, end), message, "write it in double quotes, escaped") from None


def span_of(source: Source, event: Any) -> Span:
    """The place of an event in the text; of one over several lines, the place where it begins."""
    start, end = event.start_mark, event.end_mark
    first = source.offset(start.line + 1, start.column + 1)
    last = source.offset(end.line + 1, end.column + 1) if end.line == start.line else first
    return Span(source, first, max(last, first))
