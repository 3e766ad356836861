"""What a bag of the robot says: ``python3 check_bag.py BAG ANNOUNCED.json``. It knows nothing of Midstride, nor of ROS.

The bag is one of ``recorder.py``. ANNOUNCED.json says what to hold the robot to, and when what happened::

    {"topic": "/cmd_vel", "silence": 0.5, "stale": 0.5, "reaction": 0.5,
     "silent": [{"from": 12.0, "to": 12.4}], "events": [{"name": "…", "from": 10.0, "to": 20.0}]}

Times are unix seconds. It checks that

- no command is missed: none of a writer's numbers is missing, and no two commands are more than ``silence`` apart,
  except in an interval of ``silent``, where the plan said that there would be none;
- no two writers interleave: once another has written, the one before does not write again;
- the robot does not move for longer than ``reaction`` while the scan behind its newest obstacles is older than
  ``stale``.

It prints a line of JSON for each event, with what was found in its time, and one for the whole bag. The exit status is
1 where something does not hold.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

# Below this speed (m/s) the robot stands.
STANDS = 0.05
OBSTACLES, WHEELS, INFO = "/obstacles/near", "/device/wheels", "/recorder/info"


@dataclass(frozen=True)
class Command:
    """``number``: which of its writer's messages it is; ``sent``: unix s."""

    writer: str
    number: int
    sent: float


@dataclass(frozen=True)
class Finding:
    """``kind`` was found at ``at`` (unix s), so many times, or for so many seconds."""

    kind: str
    at: float
    amount: float


def commands(reader: AnyReader, topic: str) -> list[Command]:
    """In the order in which they were sent."""
    infos = [json.loads(each.data) for _, each in messages(reader, INFO)]
    found = []
    last: dict[str, int] = {}  # by writer, the one that wrote last at the end
    for info in sorted((each for each in infos if each["topic"] == topic), key=lambda each: each["sent"]):
        number = info["number"]
        writer = info["writer"] or by_number(last, number)
        last.pop(writer, None)
        last[writer] = number
        found.append(Command(writer, number, info["sent"] / 1e9))
    return found


def by_number(last: Mapping[str, int], number: int) -> str:
    """Who wrote a message whose writer is not reported: the one nearest to its number, or else a new one."""
    nearest = max((each for each in reversed(last) if last[each] < number), key=last.__getitem__, default=None)
    return f"writer {len(last) + 1}" if nearest is None or number == 1 else nearest


def messages(reader: AnyReader, *topics: str) -> Iterator[tuple[float, Any]]:
    """When each was received (unix s), and what it says."""
    chosen = [each for each in reader.connections if each.topic in topics]
    for connection, received, data in reader.messages(chosen):
        yield received / 1e9, reader.deserialize(data, connection.msgtype)


def missed(found: Sequence[Command], silence: float, silent: Sequence[dict[str, float]]) -> Iterator[Finding]:
    """``lost``: how many were sent and are missing. ``silence``: the seconds between two that are too far apart."""

    def announced(begin: float, end: float) -> bool:
        return any(each["from"] <= begin and end <= each["to"] for each in silent)

    last: dict[str, Command] = {}
    for each in found:
        before = last.get(each.writer)
        last[each.writer] = each
        gap = 0 if before is None else each.number - before.number - 1
        if before is not None and gap > 0 and not announced(before.sent, each.sent):
            yield Finding("lost", each.sent, gap)
    for earlier, later in pairwise(found):
        if later.sent - earlier.sent > silence and not announced(earlier.sent, later.sent):
            yield Finding("silence", later.sent, later.sent - earlier.sent)


def interleaved(found: Sequence[Command]) -> Iterator[Finding]:
    """What a writer has sent after another had begun."""
    ended: set[str] = set()
    for earlier, later in pairwise(found):
        if later.writer != earlier.writer:
            ended.add(earlier.writer)
        if later.writer in ended:
            yield Finding("interleaved", later.sent, 1)


def moved_blind(reader: AnyReader, stale: float) -> Iterator[Finding]:
    """Each time that the robot moved on obstacles that were too old, and for how long."""
    scanned = begun = last = None
    for at, message in messages(reader, OBSTACLES, WHEELS):
        if hasattr(message, "ranges"):
            scanned = message.header.stamp.sec + message.header.stamp.nanosec / 1e9
            continue
        blind = abs(message.twist.twist.linear.x) > STANDS and scanned is not None and at - scanned > stale
        if blind:
            begun, last = begun or at, at
        elif begun is not None and last is not None:
            yield Finding("moved_blind", last, last - begun)
            begun = None
    if begun is not None and last is not None:
        yield Finding("moved_blind", last, last - begun)


def summary(findings: Sequence[Finding], begin: float, end: float) -> dict[str, float]:
    """How many were lost or interleaved, and the longest of the others (s), from ``begin`` to ``end``."""
    within = [each for each in findings if begin <= each.at < end]
    counts = {kind: sum(int(each.amount) for each in within if each.kind == kind) for kind in ("lost", "interleaved")}
    longest = {
        kind: round(max((each.amount for each in within if each.kind == kind), default=0.0), 3)
        for kind in ("silence", "moved_blind")
    }
    return counts | longest


def main(bag: str, announced: str) -> int:
    expected = json.loads(Path(announced).read_text(encoding="utf-8"))
    with AnyReader([Path(bag)], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        found = commands(reader, expected["topic"])
        findings = [
            *missed(found, expected["silence"], expected["silent"]),
            *interleaved(found),
            *moved_blind(reader, expected["stale"]),
        ]
    for event in expected["events"]:
        print(json.dumps({"name": event["name"], **summary(findings, event["from"], event["to"])}))
    whole = summary(findings, float("-inf"), float("inf"))
    held = bool(found) and not (whole["lost"] or whole["interleaved"] or whole["silence"])
    held = held and whole["moved_blind"] <= expected["reaction"]
    writers = len({each.writer for each in found})
    print(json.dumps({"commands": len(found), "writers": writers, **whole, "holds": held}))
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
