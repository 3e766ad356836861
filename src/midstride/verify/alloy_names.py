"""Names for atoms: Alloy identifiers that read like the names of the file, and what each stands for."""

from __future__ import annotations

import re
from typing import Final

from midstride.verify.library import declared_names

# Alloy's keywords, and the names that a dump declares beside the bundled specification.
_RESERVED: Final = """abstract after all always and as assert before but check disj else enabled enum eventually exactly
    expect extends fact for fun historically iden iff implies in Int int invariant let lone modifies module no none not
    once one open or pred private releases run seq set sig since some steps String sum this triggered univ until var
    Best better Capped Clause Findings findings Rules Step Verdict Verified"""
_INVALID: Final = re.compile(r"[^A-Za-z0-9]+")


class Names:
    """Assigns each identifier once, and remembers what it stands for."""

    def __init__(self) -> None:
        self._taken = set(_RESERVED.split()) | declared_names()
        self.meanings: dict[str, object] = {}

    def assign(self, base: str, meaning: object) -> str:
        """An identifier like ``base``, for ``meaning`` alone."""
        stem = "_".join(_INVALID.sub("_", part).strip("_") for part in base.split("__")) or "x"
        if not stem[0].isalpha():
            stem = f"x{stem}"
        name, number = stem, 1
        while name in self._taken or name.endswith(("_may", "_holds")):  # names of the predicates of steps
            number += 1
            name = f"{stem}_{number}"
        self._taken.add(name)
        self.meanings[name] = meaning
        return name
