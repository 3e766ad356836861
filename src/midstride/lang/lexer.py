"""The lexer. It accepts every text: invalid characters are reported once and skipped.

A token's kind is ``name`` (``scan``), ``path`` (``/scan``, ``sensor_msgs/msg/Image``, ``~/reset``), ``number``,
``string``, ``end``, or the punctuation itself. Comments are kept separately, for the printer.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from midstride.lang.diagnostic_text import Reporter
from midstride.lang.source import Source, Span

# The alternatives are tried in this order. A word may contain slashes and letters that are invalid in names: it is
# validated as a whole, so that it is reported once.
_PATTERN: Final = re.compile(
    r"""
      (?P<blank>[ \t\n\f\v]+)
    | (?P<comment>\#[^\n]*|//[^\n]*)
    | (?P<word>(?:[^\W\d]|~|/(?!/))(?:[\w/]|-(?=\w))*)
    | (?P<number>-inf(?!\w)|[+-]?(?:[0-9]+(?:\.[0-9]+)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)
    | (?P<string>"(?:[^"\\\n]|\\[^\n])*"?\\?)
    | (?P<quoted>'(?:[^'\\\n]|\\[^\n])*'?\\?)
    | (?P<sign><-|->|<=|>=|==|!=|[{}()\[\]:=@,.<>])
    | (?P<bad>(?:[^\w\s"'{}()\[\]:=@,.<>~/\#])+|.)
    """,
    re.VERBOSE | re.DOTALL,
)
_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_PATH: Final = re.compile(r"(?:~|(?:~?/)?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_0-9][A-Za-z0-9_]*)*)")
_MAX_NAME: Final = 255  # the limit of ROS 2 for node names
_MAX_STRING: Final = 8192
_ESCAPES: Final = {"n": "\n", "t": "\t", '"': '"', "\\": "\\"}


@dataclass(frozen=True, slots=True)
class Tokens:
    """The tokens of a source as parallel lists, the last of kind ``end``; the comments as (start, end) offsets."""

    source: Source
    kinds: list[str]
    texts: list[str]
    starts: list[int]
    comments: list[tuple[int, int]]

    def span(self, index: int) -> Span:
        start = self.starts[index]
        return Span(self.source, start, start + len(self.texts[index]))


def tokenize(source: Source, reporter: Reporter) -> Tokens:
    """The tokens of ``source``, in time linear in its length."""
    kinds: list[str] = []
    texts: list[str] = []
    starts: list[int] = []
    comments: list[tuple[int, int]] = []
    add_kind, add_text, add_start = kinds.append, texts.append, starts.append
    for match in _PATTERN.finditer(source.text):
        group = match.lastgroup
        if group == "blank":
            continue
        text, start = match.group(), match.start()
        if group == "word":
            kind = "name" if _NAME.fullmatch(text) else "path"
            if len(text) > _MAX_NAME or (kind == "path" and not _PATH.fullmatch(text)):
                _invalid_word(Span(source, start, match.end()), reporter)
        elif group == "sign":
            kind = text
        elif group == "comment":
            comments.append((start, match.end()))
            if text[0] == "/":
                span = Span(source, start, start + 2)
                reporter.report("E110", span, "`//` does not start a comment", help="comments start with `#`")
            continue
        elif group == "number":
            kind = "number"
        elif group == "string" or group == "quoted":
            kind = "string"
            _check_string(Span(source, start, match.end()), reporter)
        else:
            _invalid_characters(Span(source, start, match.end()), reporter)
            continue
        add_kind(kind)
        add_text(text)
        add_start(start)
    add_kind("end")
    add_text("")
    add_start(len(source.text))
    return Tokens(source, kinds, texts, starts, comments)


def string_value(text: str) -> str:
    """The value of a string token; :func:`tokenize` has reported any errors in it."""
    quote = text[0]
    body = text[1:-1] if len(text) > 1 and text[-1] == quote else text[1:]
    body = body[:_MAX_STRING]
    if "\\" not in body:
        return body
    return re.sub(r"\\(.)", lambda match: _ESCAPES.get(match[1], match[0]), body)


def is_topic_name(text: str) -> bool:
    """Return whether ``text`` is a valid ROS name or path."""
    return len(text) <= _MAX_NAME and _PATH.fullmatch(text) is not None


def _invalid_word(span: Span, reporter: Reporter) -> None:
    text = span.text
    odd = next((at for at, character in enumerate(text) if character == "-" or not character.isascii()), None)
    if len(text) > _MAX_NAME:
        help = f"names have at most {_MAX_NAME} characters"
        reporter.report("E111", span, f"`{truncated(text)}` is too long for a name", help=help)
    elif odd is not None:
        place = Span(span.source, span.start + odd, span.start + odd + 1)
        shown = f"`{text[odd]}`" if text[odd].isprintable() else f"the character U+{ord(text[odd]):04X}"
        help = "names consist of ASCII letters, digits and `_`, as in ROS"
        if text.startswith("/") and text[odd] == "-":
            help += f'; put the path of a device in double quotes: "{truncated(text)}"'
        reporter.report("E110", place, f"{shown} is not allowed in a name", help=help)
    else:
        message = f"`{truncated(text)}` is not a valid ROS name"
        help = "no part of a name can be empty or start with a digit; for example `/front/scan`"
        reporter.report("E111", span, message, help=help)


def _check_string(span: Span, reporter: Reporter) -> None:
    text = span.text
    if len(text) > _MAX_STRING:
        reporter.report("E113", span, "this string is too long", help=f"strings have at most {_MAX_STRING} characters")
        return
    if text[0] == "'":
        help = f'write "{truncated(text[1:].rstrip(chr(39)))}"'
        reporter.report("E112", span, "strings use double quotes", help=help)
        return
    if re.fullmatch(r'"(?:[^"\\]|\\.)*"', text) is None:
        reporter.report("E113", span, "unterminated string", help='end it with `"` on the same line')
        return
    for escape in re.finditer(r"\\(.)", text):
        if escape[1] not in _ESCAPES:
            place = Span(span.source, span.start + escape.start(), span.start + escape.end())
            shown = f"`{escape[0]}`" if escape[1].isprintable() else "this"
            help = r"the escape sequences are `\\`, `\"`, `\n` and `\t`"
            reporter.report("E114", place, f"{shown} is not an escape sequence", help=help)
            return


def _invalid_characters(span: Span, reporter: Reporter) -> None:
    text = span.text
    if "\0" in text:
        at = span.start + text.index("\0")
        help = "check that this is the intended file"
        reporter.report("E115", Span(span.source, at, at + 1), "NUL byte in the text", help=help)
        return
    hints = {
        ";": "statements need no terminator; remove it",
        "-": "names consist of letters, digits and `_`; put a path with other characters in double quotes",
        "*": "comments start with `#` and end with the line",
        "|": "join alternatives with `or`",
        "$": "there is no variable substitution; write the name itself",
    }
    shown = f"`{text[0]}`" if text[0].isprintable() else f"U+{ord(text[0]):04X}"
    reporter.report("E110", span, f"unexpected character {shown}", help=hints.get(text[0]))


def truncated(text: str) -> str:
    """``text`` for a message, shortened if it is long."""
    return text if len(text) <= 40 else text[:39] + "…"
