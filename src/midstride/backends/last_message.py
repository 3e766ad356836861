"""The last message on a topic that the manager listens to, judged as a condition of a component is.

There are two subscriptions: a volatile, best-effort one, which every publisher matches, and a transient-local one for
what was written before. What the latter receives counts unless it is older than what is known already.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from midstride.model.contract import Predicate, QoS
from midstride.node.author.field_checks import FieldChecks
from midstride.runtime.backend_protocol import HeardMessage

# Of the two subscriptions; the last message alone counts.
EVERY = QoS(reliability="best_effort", durability="volatile", history="keep_last", depth=1)
KEPT = QoS(reliability="reliable", durability="transient_local", history="keep_last", depth=1)


class LastMessage:
    """The last message on one topic; its fields are checked by ``assumption``."""

    def __init__(self, assumption: Predicate) -> None:
        self._fields = FieldChecks(assumption.fields)
        self._at: float | None = None
        self._written: int | None = None
        self._writer: str | None = None

    def received(self, message: Any, at: float, written: int | None, writer: str | None, *, kept: bool) -> None:
        """A message has arrived ``at`` (steady s); when it was ``written`` (ns) and by which publisher, if known.

        ``kept``: by the transient-local subscription, which also receives what was written before.
        """
        if kept and None not in (written, self._written) and self._at is not None:
            assert written is not None and self._written is not None
            if written < self._written:
                return
        self._fields.check(message)
        self._at, self._written, self._writer = at, written, writer

    def may_be_gone(self, publishers: Collection[str], before: Collection[str] = ()) -> bool:
        """Return whether the publisher of the message may be gone, where there are these ``publishers`` now.

        ``before``: those that there were earlier, where it is not known which of them has written the message.
        """
        if self._at is None:
            return False
        return self._writer not in publishers if self._writer is not None else not {*before} <= {*publishers}

    def forget(self) -> None:
        """The publisher of the message is gone: what it said is not known to hold any more."""
        self._at = self._written = self._writer = None

    def heard(self, publishers: int) -> HeardMessage:
        """The message as far as it is known now, where the topic has so many publishers."""
        unmet = tuple(f"{path} is {samples.last}" for path, samples in self._fields.samples().items() if samples.run)
        return HeardMessage(self._at, unmet, publishers)
