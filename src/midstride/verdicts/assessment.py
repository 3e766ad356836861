"""The assessments of a change, and the headline that follows from them: the weakest."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, Final, Literal, TypeAlias

from msgspec import Meta

from midstride.codec.form import Form

Continuity: TypeAlias = Literal["kept", "not_measurable", "lost"]

# How many names a headline has.
_NAMED: Final = 4


class Assessment(Form, frozen=True, omit_defaults=False, forbid_unknown_fields=False):
    """An assessment of the work of a functionality, an output or a node.

    `lasting`: it is so afterwards, and no plan led there.
    """

    subject: str
    verdict: Continuity
    words: Annotated[str, Meta(description="the sentence, without a full stop")]
    seconds: Annotated[float | None, Meta(description="for how long it was lost; null: not lost, or not known")] = None
    lasting: bool = False
    at_most: Annotated[bool, Meta(description="it was lost for no longer than `seconds`, and maybe for less")] = False


class Assessments(Form, frozen=True, omit_defaults=False, forbid_unknown_fields=False):
    """All that is known about the work of a system during a change. `verdict`: the weakest of them."""

    verdict: Continuity
    headline: str
    found: list[Assessment]

    @property
    def in_short(self) -> str:
        """``kept``, ``not measurable``, ``lost 1.20 s``, ``lost at most 1.20 s``: for a table."""
        if self.verdict != "lost" or (longest := self.lost_seconds) is None:
            return self.verdict.replace("_", " ")
        at_most = all(each.at_most for each in self.found if each.seconds == longest)
        return f"lost {time_in_words(longest, at_most=at_most)}"

    @property
    def lasting(self) -> bool:
        """Return whether something is lost afterwards that no plan has asked for."""
        return any(each.lasting for each in self.found)

    @property
    def lines(self) -> list[str]:
        """All of it in sentences: what was lost, each for itself, and what is not measurable; else the headline."""
        if self.verdict != "lost":
            return [self.headline]
        unknown = "Not measurable here: "
        return [f"{'' if each.verdict == 'lost' else unknown}{each.words}." for each in self.found]

    @property
    def weakest(self) -> list[str]:
        """The sentences that make its verdict the weakest that it is, where that is not `kept`."""
        return [each.words for each in self.found if each.verdict == self.verdict]

    @property
    def lost_seconds(self) -> float | None:
        """The longest time for which something was lost (s), or may have been; None where none is known."""
        return max((each.seconds for each in self.found if each.seconds is not None), default=None)


def seconds_in_words(value: float) -> str:
    """A duration with three significant digits or so."""
    if value >= 10:
        return f"{value:.1f} s"
    return f"{value:.2f} s" if value >= 1 else f"{value * 1000:.0f} ms"


def assessed(found: Iterable[Assessment | None]) -> Assessments:
    """Return what may be said of a change that has been carried out."""
    known = [each for each in found if each is not None]
    if not known:
        return Assessments("kept", "Nothing fell below its level.", [])
    lost, unknown = split_by_verdict(known)
    if not lost:
        headline = f"Nothing is known to have fallen below its level. Not measurable here: {sentences(unknown)}."
        return Assessments("not_measurable", headline, known)
    times = [f"{each.subject}{_for(each)}" for each in lost]
    besides = f"; {len(unknown)} not measurable here" if unknown else ""
    return Assessments("lost", f"Lost: {some_of(times)}{besides}.", known)


def expected(found: Iterable[Assessment | None]) -> Assessments:
    """Return what may be said of a plan."""
    known = [each for each in found if each is not None]
    if not known:
        words = "Nothing degrades: every functionality that remains keeps its level throughout."
        return Assessments("kept", words, [])
    lost, unknown = split_by_verdict(known)
    if not lost:
        headline = f"Nothing is known to degrade. Not measurable here: {sentences(unknown)}."
        return Assessments("not_measurable", headline, known)
    return Assessments("lost", f"Lost on the way: {some_of([each.subject for each in lost])}.", known)


def silence_in_words(words: str, seconds: float | None) -> str:
    """Return what is silent, and for how long (s)."""
    return words if seconds is None else f"{words} (for {seconds_in_words(seconds)})"


def listed(words: Sequence[str]) -> str:
    """``a, b and c``"""
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def split_by_verdict(found: Sequence[Assessment]) -> tuple[list[Assessment], list[Assessment]]:
    lost = [each for each in found if each.verdict == "lost"]
    return lost, [each for each in found if each.verdict == "not_measurable"]


def sentences(unknown: Sequence[Assessment]) -> str:
    return "; ".join(each.words for each in unknown)


def _for(lost: Assessment) -> str:
    if lost.seconds is None:
        return ""
    # When the first message came after that, nothing counts.
    until = " until a node was active again," if lost.at_most else " for"
    return f"{until} {time_in_words(lost.seconds, at_most=lost.at_most)}"


def time_in_words(seconds: float, *, at_most: bool) -> str:
    return f"{'at most ' if at_most else ''}{seconds_in_words(seconds)}"


def some_of(words: Sequence[str]) -> str:
    more = len(words) - _NAMED
    return ", ".join(words[:_NAMED]) + (f" and {more} more" if more > 0 else "")
