"""Receipts of a node without Midstride's API while a change is measured, as the library in its process notes them.

The library notes what the node takes by rcl: when, and what the middleware says of the message. rclcpp's messages
within a process are not among these.
"""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from midstride.errors import CommandRefused
from midstride.foreign.gates import Gates
from midstride.foreign.page_layout import RECEIPTS, PagePort, PageReceipt, PageReceipts
from midstride.wire import commands, replies

# How long a call that was taking a message when noting began may take to count it (s).
TAKING: Final = 0.01


@dataclass
class ReceiptNotes:
    """The messages that the inputs of ``gates`` receive, once that is asked for.

    ``simulated``: its node follows ``/clock``.
    """

    gates: Gates
    simulated: bool
    sleep: Callable[[float], Awaitable[None]]
    _begun: dict[str, tuple[int, int]] = field(default_factory=dict)  # by input: how many were noted, and taken

    async def switch(self, command: commands.RecordCommand) -> replies.RecordingSwitched:
        """Note what these inputs receive, or no longer. Raises CommandRefused where it would not be known."""
        for name in command.inputs:
            if command.on:
                await self._begin(name)
            else:
                self._begun.pop(name, None)
                self.gates.entry(name).recorded = 0
        return replies.RecordingSwitched(now=time.monotonic_ns())

    async def _begin(self, name: str) -> None:
        entry = self.gates.entry(name)
        if self.simulated:
            raise CommandRefused(f"when {name} receives a message is not known on the ROS clock")
        if not _taken(entry):
            raise CommandRefused(f"{name} has received nothing yet that the library sees")
        path = self._path(entry)
        try:
            with open(path, "ab") as file:  # the library keeps the file of an earlier change mapped
                os.posix_fallocate(file.fileno(), 0, ctypes.sizeof(PageReceipts))
        except OSError as error:
            raise CommandRefused(f"{path} cannot be written: {error.strerror or error}") from None
        entry.recorded = 1
        await self.sleep(TAKING)
        self._begun[name] = self.noted(name), _taken(entry)

    async def read(self, command: commands.RecordsCommand) -> replies.Records:
        """Return what an input has received until now. Raises CommandRefused where some of it is not known."""
        if (begun := self._begun.get(command.input)) is None:
            raise CommandRefused(f"{command.input} is not recorded")
        entry = self.gates.entry(command.input)
        taken = _taken(entry)
        path = self._path(entry)
        now, count = time.monotonic_ns(), self.noted(command.input)
        if count - begun[0] < taken - begun[1]:
            raise CommandRefused(f"not all that {command.input} has received was noted")
        if count - begun[0] > RECEIPTS:
            raise CommandRefused(f"{command.input} has received more than {RECEIPTS} messages meanwhile")
        if (noted := _last(path, begun[0], count)) is None:  # a thread is writing one
            await self.sleep(TAKING)
            noted = _last(path, begun[0], count)
        if noted is None:
            raise CommandRefused(f"not all that {command.input} has received was noted")
        rows = [_receipt(each) for each in noted if each.received <= now]
        rows = list({(row.publisher, row.number): row for row in rows if row.number is not None}.values()) + [
            row for row in rows if row.number is None
        ]
        return replies.Records(rows=rows, publisher_identity=bool(rows), now=now)

    def noted(self, name: str) -> int:
        """The number of messages of an input noted in all. Raises CommandRefused where that cannot be read."""
        path = self._path(self.gates.entry(name))
        try:
            with open(path, "rb") as file:
                return int.from_bytes(file.read(ctypes.sizeof(ctypes.c_uint64)), "little")
        except OSError as error:
            raise CommandRefused(f"{path} cannot be read: {error.strerror or error}") from None

    def _path(self, entry: PagePort) -> Path:
        page = self.gates.page.path
        return page.with_name(f"{page.name}.{self.gates.index}.receipts.{entry.number}")


def _taken(entry: PagePort) -> int:
    return int(entry.passed + entry.gated)


def _last(path: Path, begin: int, end: int) -> list[PageReceipt] | None:
    """The receipts of the places from ``begin`` to ``end``, in their order; None where one is not complete."""
    try:
        found = PageReceipts.from_buffer_copy(path.read_bytes())
    except (OSError, ValueError) as error:
        raise CommandRefused(f"{path} cannot be read: {error}") from None
    receipts = [found.last[place % RECEIPTS] for place in range(begin, end)]
    return receipts if all(each.place == place + 1 for place, each in enumerate(receipts, begin)) else None


def _receipt(noted: PageReceipt) -> replies.Receipt:
    """A receipt of which the numbers are None that the middleware does not give."""
    return replies.Receipt(noted.received, noted.sent or None, noted.number or None, bytes(noted.writer).hex())
