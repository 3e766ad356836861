"""From text to tokens. Every text has tokens: what is none is reported once and left out.

A token's kind is ``name`` (``scan``), ``path`` (``/scan``, ``sensor_msgs/msg/Image``, ``~/reset``), ``number``,
``string``, ``end``, or, for a sign, the sign itself. Comments are kept beside the tokens, for the printer.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from midstride.lang.diagnostics import Reporter
from midstride.lang.source import Source, Span

# The alternatives are tried in this order. A word may hold slashes, and letters that no name may have: it is judged
# whole.
_PATTERN: Final = re.compile(
    r"""
      (?P<blank>[ \t\n\f\v]+)
    | (?P<comment>\#[^\n]*|//[^\n]*)
    | (?P<word>(?:[^\W\d]|~|/(?!/))(?:[\w/]|-(?=\w))*)
    | (?P<number>[+-]?(?:[0-9]+(?:\.[0-9]+)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)
    | (?P<string>"(?:[^"\\\n]|\\[^\n])*"?\\?)
    | (?P<quoted>'(?:[^'\\\n]|\\[^\n])*'?\\?)
    | (?P<sign><-|->|<=|>=|==|!=|[{}()\[\]:=@,.<>])
    | (?P<bad>(?:[^\w\s"'{}()\[\]:=@,.<>~/\#])+|.)
    """,
    re.VERBOSE | re.DOTALL,
)
_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_PATH: Final = re.compile(r"(?:~|(?:~?/)?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_0-9][A-Za-z0-9_]*)*)")
_LONGEST_NAME: Final = 255  # what ROS 2 allows of a node's name
_LONGEST_TEXT: Final = 8192
_ESCAPES: Final = {"n": "\n", "t": "\t", '"': '"', "\\": "\\"}


@dataclass(frozen=True, slots=True)
class Tokens:
    """The tokens of a source as parallel lists, the last of kind ``end``; the comments as (start, end)."""

    source: Source
    kinds: list[str]
    texts: list[str]
    starts: list[int]
    comments: list[tuple[int, int]]

    def span(self, index: int) -> Span:
        start = self.starts[index]
        return Span(self.source, start, start + len(self.texts[index]))


def tokenize(source: Source, reporter: Reporter) -> Tokens:
    """The tokens of ``source``. Linear in its length, whatever it holds."""
    kinds: list[str] = []
    texts: list[str] = []
    starts: list[int] = []
    comments: list[tuple[int, int]] = []
    add_kind, add_text, add_start = kinds.append, texts.append, starts.append
    is_name = _NAME.fullmatch
    for match in _PATTERN.finditer(source.text):
        group = match.lastgroup
        if group == "blank":
            continue
        text, start = match.group(), match.start()
        if group == "word":
            kind = "name" if is_name(text) else "path"
            if len(text) > _LONGEST_NAME or (kind == "path" and not _PATH.fullmatch(text)):
                _bad_word(Span(source, start, match.end()), reporter)
        elif group == "sign":
            kind = text
        elif group == "comment":
            comments.append((start, match.end()))
            if text[0] == "/":
                span = Span(source, start, start + 2)
                reporter.report("E110", span, "`//` begins no comment here", help="comments begin with `#`")
            continue
        elif group == "number":
            kind = "number"
        elif group == "string" or group == "quoted":
            kind = "string"
            _check_string(Span(source, start, match.end()), reporter)
        else:
            _bad_characters(Span(source, start, match.end()), reporter)
            continue
        add_kind(kind)
        add_text(text)
        add_start(start)
    add_kind("end")
    add_text("")
    add_start(len(source.text))
    return Tokens(source, kinds, texts, starts, comments)


def string_value(text: str) -> str:
    """What a string token stands for; faults in it have been reported by :func:`tokenize`."""
    quote = text[0]
    body = text[1:-1] if len(text) > 1 and text[-1] == quote else text[1:]
    body = body[:_LONGEST_TEXT]
    if "\\" not in body:
        return body
    return re.sub(r"\\(.)", lambda match: _ESCAPES.get(match[1], match[0]), body)


def is_topic_name(text: str) -> bool:
    """Whether ``text`` is a name or path as ROS has them."""
    return len(text) <= _LONGEST_NAME and _PATH.fullmatch(text) is not None


def _bad_word(span: Span, reporter: Reporter) -> None:
    text = span.text
    odd = next((at for at, character in enumerate(text) if character == "-" or not character.isascii()), None)
    if len(text) > _LONGEST_NAME:
        help = f"a name has at most {_LONGEST_NAME} characters"
        reporter.report("E111", span, f"`{_short(text)}` is too long for a name", help=help)
    elif odd is not None:
        place = Span(span.source, span.start + odd, span.start + odd + 1)
        shown = f"`{text[odd]}`" if text[odd].isprintable() else f"the character U+{ord(text[odd]):04X}"
        help = "a name has the letters a to z and A to Z, digits and `_`, as in ROS"
        if text.startswith("/") and text[odd] == "-":
            help += f'; the path of a device may stand in double quotes: "{_short(text)}"'
        reporter.report("E110", place, f"{shown} may not stand in a name", help=help)
    else:
        message = f"`{_short(text)}` is no name as ROS has them"
        reporter.report("E111", span, message, help="no part of it may be empty or begin with a digit: `/front/scan`")


def _check_string(span: Span, reporter: Reporter) -> None:
    text = span.text
    if len(text) > _LONGEST_TEXT:
        reporter.report("E113", span, "this text is too long", help=f"a text has at most {_LONGEST_TEXT} characters")
        return
    if text[0] == "'":
        reporter.report(
            "E112", span, "a text stands in double quotes", help=f'write "{_short(text[1:].rstrip(chr(39)))}"'
        )
        return
    closed = re.fullmatch(r'"(?:[^"\\]|\\.)*"', text)
    if closed is None:
        reporter.report("E113", span, "this text is not closed", help='end it with `"` on the same line')
        return
    for escape in re.finditer(r"\\(.)", text):
        if escape[1] not in _ESCAPES:
            place = Span(span.source, span.start + escape.start(), span.start + escape.end())
            shown = escape[0] if escape[1].isprintable() else "that"
            message = f"`{shown}` stands for nothing in a text"
            reporter.report(
                "E114", place, message, help=r"write `\\` for a backslash; beside it there are `\"`, `\n` and `\t`"
            )
            return


def _bad_characters(span: Span, reporter: Reporter) -> None:
    text = span.text
    if "\0" in text:
        at = span.start + text.index("\0")
        place = Span(span.source, at, at + 1)
        reporter.report("E115", place, "there is a NUL byte here: this is no text", help="is this the file you meant?")
        return
    hints = {
        ";": "a statement needs no end: leave it out",
        "-": "a name has letters, digits and `_`; a path with other characters stands in double quotes",
        "*": "a comment begins with `#` and ends with the line",
        "|": "alternatives are joined by `or`",
        "$": "nothing is substituted: write the name itself",
    }
    shown = text[0] if text[0].isprintable() else f"the character U+{ord(text[0]):04X}"
    shown = f"`{shown}`" if len(shown) == 1 else shown
    reporter.report("E110", span, f"{shown} means nothing here", help=hints.get(text[0]))


def _short(text: str) -> str:
    return text if len(text) <= 40 else text[:39] + "…"
