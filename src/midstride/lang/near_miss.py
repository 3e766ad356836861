"""Near-misses: the name that was probably meant."""

from __future__ import annotations

from collections.abc import Iterable

# Comparing a typing error with every name of a large system must stay cheap, and nobody mistypes a novel.
_LONGEST = 64


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The one of ``known`` that is closest to ``word`` by typing errors, or None where none is near."""
    if len(word) > _LONGEST:
        return None
    allowed = 1 if len(word) <= 3 else 2 if len(word) <= 8 else 3
    found: str | None = None
    best = allowed + 1
    lower = word.lower()
    for name in sorted(set(known)):
        if name == word or abs(len(name) - len(word)) > min(best, allowed) or len(name) > _LONGEST:
            continue
        distance = _distance(lower, name.lower(), best + 1)
        # A name of two letters is within two typing errors of everything.
        if distance > min(best, allowed) or distance >= max(len(name), len(word)):
            continue
        if distance == best and _distance(word, name, _LONGEST) >= _distance(word, found or "", _LONGEST):
            continue  # of two that differ in capitals alone, the one whose capitals fit
        found, best = name, distance
    return found


def _begun(word: str, known: Iterable[str]) -> str | None:
    """The longest of ``known`` that ``word`` begins with, else the shortest that begins with it: `Bool` for `Boolean`.
    Three letters are the least that say anything."""
    word = word.lower()
    inside = [name for name in known if len(name) > 2 and word.startswith(name.lower())]
    around = [name for name in known if len(word) > 2 and name.lower().startswith(word)]
    return max(inside, key=len, default=None) or min(around, key=len, default=None)


def did_you_mean(word: str, known: Iterable[str]) -> str | None:
    """``did you mean `scan`?``, or None."""
    known = tuple(known)
    found = nearest(word, known) or _begun(word, known)
    return None if found is None else f"did you mean `{found}`?"


def _distance(a: str, b: str, bound: int) -> int:
    """The number of insertions, deletions, replacements and swaps of neighbours between two words, up to ``bound``."""
    before: list[int] = []
    row = list(range(len(b) + 1))
    for i, left in enumerate(a, 1):
        previous, row, older = row, [i], before
        for j, right in enumerate(b, 1):
            cost = min(previous[j] + 1, row[j - 1] + 1, previous[j - 1] + (left != right))
            if i > 1 and j > 1 and left == b[j - 2] and a[i - 2] == right:
                cost = min(cost, older[j - 2] + 1)
            row.append(cost)
        before = previous
        if min(row) >= bound:
            return bound
    return row[-1]
