"""Named states and the events that change them, each held to a table.

An event that the table does not have for a state is a mistake in Midstride's own code. Tests and the simulation raise
it as :class:`ForbiddenTransition`; a manager in production logs it, keeps the state, and goes on.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Final, Generic, TypeVar

S = TypeVar("S", bound=Enum)
E = TypeVar("E", bound=Enum)

log = logging.getLogger(__name__)

# Set for tests, and for the managers that they start: a forbidden transition raises.
ENV_STRICT: Final = "MIDSTRIDE_STRICT_TRANSITIONS"


class ForbiddenTransition(AssertionError):
    """An event has happened in a state in which it must not."""


def reject(words: str) -> None:
    """Raise ForbiddenTransition."""
    raise ForbiddenTransition(words)


def survive(words: str) -> None:
    """Log it as an error, and go on."""
    log.error("%s; the state is kept", words)


@dataclass
class Policy:
    """``on_forbidden`` is called with each transition that the tables do not have."""

    on_forbidden: Callable[[str], None]


POLICY: Final = Policy(reject if os.environ.get(ENV_STRICT) else survive)


@dataclass(frozen=True, slots=True)
class Transitions(Generic[S, E]):
    """``table``: to each state the events that may happen in it, and the state that each leads to."""

    table: Mapping[S, Mapping[E, S]]

    @classmethod
    def read(cls, states: type[S], events: type[E], text: str) -> Transitions[S, E]:
        """The table that ``text`` shows: a line of states, then one for each event, with the state that it leads to.

        A dot is a transition that must not happen.
        """
        (_, *heads), *lines = (line.split() for line in text.strip().splitlines())
        table: dict[S, dict[E, S]] = {state: {} for state in states}
        for event, *cells in lines:
            for head, cell in zip(heads, cells, strict=True):
                if cell != ".":
                    table[states[head.upper()]][events[event.upper()]] = states[cell.upper()]
        return cls(table)

    def after(self, state: S, event: E, of: str) -> S:
        """The state after ``event``; where it must not happen, the same one, after :data:`POLICY` was applied.

        ``of`` names what has the state. Raises ForbiddenTransition where that is the policy.
        """
        following = self.table[state].get(event)
        if following is None:
            POLICY.on_forbidden(f"{of}: {event.name} must not happen in the state {state.name}")
            return state
        return following
