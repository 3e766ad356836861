"""One change after another, each requested from the manager with its events."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Any

from midstride.cli.client import Client
from midstride.cli.follow import Sending, last_event_number
from midstride.codec.form import Document
from midstride.errors import MidstrideError
from midstride.runtime.records.measure import SwapReport
from midstride.runtime.records.reports import Event, Outcome


class Changes:
    """Requests changes. A change that is being watched or measured does not keep the next one waiting.

    ``file`` is the one that specifications are read from. With ``with_other_nodes``, nodes that end with a
    process are meant.
    """

    def __init__(self, client: Client, file: str, *, with_other_nodes: bool = False) -> None:
        self._client = client
        self._with_other_nodes = with_other_nodes
        self._file = file
        self._events: queue.Queue[Event | str] = queue.Queue()  # also the id of a request that was answered
        self._unanswered: dict[str, Sending] = {}
        since = last_event_number(client)
        threading.Thread(target=self._follow, args=(since,), daemon=True).start()

    def _follow(self, since: int) -> None:
        try:
            for event in self._client.events(since):
                self._events.put(event)
        except MidstrideError:  # the next request reports it
            pass

    def carry_out(self, request: Document, finished: Callable[[Outcome], None]) -> str | None:
        """Request a change, and wait until its new publishers are let in or it has failed; the reason where it has.

        Once a change whose new publishers were let in has been watched and measured, or was taken back after all,
        ``finished`` is called with the outcome, in another thread. Raises the manager's error.
        """
        sending, let_in = Sending(), threading.Event()
        id = sending.id
        self._unanswered[id] = sending
        answer: list[Outcome | MidstrideError] = []

        def send() -> None:
            try:
                asked = {**request, "with_other_nodes": self._with_other_nodes}
                change = {"request": asked, "brief": True, "id": id, "file": self._file, "by": "midstride dev"}
                outcome = self._client.change(change, sending.begin)
                answer.append(outcome)
                if outcome.outcome == "done" or let_in.is_set():
                    finished(outcome)
            except MidstrideError as error:
                answer.append(error)
            del self._unanswered[id]
            self._events.put(id)

        threading.Thread(target=send, daemon=True).start()
        ours = False
        while True:
            event = self._events.get()
            if isinstance(event, str):
                if event != id:
                    continue
                if isinstance(answer[0], MidstrideError):
                    raise answer[0]
                return None if answer[0].outcome == "done" else str(answer[0].because)
            if event.kind == "command":
                ours = event.id == id
            elif event.kind == "step_failed" and ours:
                return event.words
            elif event.kind in ("watching", "measuring") and ours:
                let_in.set()
                return None

    def interrupted(self) -> list[str]:
        """Request nothing more; what becomes of each request that is not answered yet."""
        return [sending.interrupted(self._client) for sending in list(self._unanswered.values())]


def worst(swaps: list[SwapReport], figure: str) -> Any:
    """The largest of the figures of all subscribers, None where one of them is unknown."""
    values = [getattr(swap, figure) for swap in swaps]
    return None if None in values else max(values, default=None)
