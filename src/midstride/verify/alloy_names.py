"""Names for atoms: Alloy identifiers that still read like the file's own names, and the way back."""

from __future__ import annotations

import re
from typing import Final

from midstride.verify.library import declared

# Alloy's own words, and those that a dump adds to the specification it carries along.
_WORDS: Final = """abstract after all always and as assert before but check disj else enabled enum eventually exactly
    expect extends fact for fun historically iden iff implies in Int int invariant let lone modifies module no none not
    once one open or pred private releases run seq set sig since some steps String sum this triggered univ until var
    Best better Capped Clause Findings findings Rules Step Verdict Verified"""
_STRANGE: Final = re.compile(r"[^A-Za-z0-9]+")


class Names:
    """Hands out identifiers, each once, and remembers what bears them."""

    def __init__(self) -> None:
        self._taken = set(_WORDS.split()) | declared()
        self.bearers: dict[str, object] = {}

    def give(self, wanted: str, bearer: object) -> str:
        """An identifier like ``wanted``, for ``bearer`` alone."""
        base = "_".join(_STRANGE.sub("_", part).strip("_") for part in wanted.split("__")) or "x"
        if not base[0].isalpha():
            base = f"x{base}"
        name, number = base, 1
        while name in self._taken or name.endswith(("_may", "_holds")):  # predicates of steps
            number += 1
            name = f"{base}_{number}"
        self._taken.add(name)
        self.bearers[name] = bearer
        return name
