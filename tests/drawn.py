"""How many examples a property is tried on."""

from __future__ import annotations

from hypothesis import settings

# hypothesis's own number, which the profile of `make test-all` keeps.
_WHOLE = 100


def examples(thorough: int) -> int:
    """`thorough` in `make test-all`; in `make test`, as large a share of them as its profile takes of 100."""
    return max(1, thorough * min(settings().max_examples, _WHOLE) // _WHOLE)
