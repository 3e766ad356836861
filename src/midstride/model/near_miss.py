"""The name that was probably meant: the one matcher behind every "did you mean"."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher
from typing import Final

_CUTOFF: Final = 0.6  # difflib's own default
# A misspelt name is compared with every name of a large system, so long ones are left out.
_LONGEST: Final = 64


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The name most similar to ``word``, case aside; None where none is similar. Of equals the first by name, but one
    whose capitals agree comes before one whose capitals do not."""
    if len(word) > _LONGEST:
        return None
    matcher = SequenceMatcher(b=word.lower())
    found, best = None, (_CUTOFF, -1.0)
    for name in sorted(set(known)):
        if name == word or len(name) > _LONGEST:
            continue
        matcher.set_seq1(name.lower())
        if matcher.real_quick_ratio() < best[0] or matcher.quick_ratio() < best[0]:
            continue
        score = (matcher.ratio(), SequenceMatcher(None, name, word).ratio())
        if score > best:
            found, best = name, score
    return found


def did_you_mean(word: str, known: Iterable[str]) -> str | None:
    """``did you mean `scan`?`` for a similar name, or for one that ``word`` abbreviates or extends (`Bool` for
    `Boolean`); None where there is neither."""
    names = sorted(set(known))
    found = nearest(word, names) or _abbreviated(word, names)
    return None if found is None else f"did you mean `{found}`?"


def _abbreviated(word: str, names: Iterable[str]) -> str | None:
    """The longest name that ``word`` begins with, else the shortest that begins with it; of three letters at least."""
    bare = _bare(word)
    shorter = [name for name in names if len(_bare(name)) > 2 and bare.startswith(_bare(name))]
    longer = [name for name in names if len(bare) > 2 and _bare(name).startswith(bare)]
    return max(shorter, key=len, default=None) or min(longer, key=len, default=None)


def _bare(name: str) -> str:
    return name.strip("/").lower().replace("_", "")
