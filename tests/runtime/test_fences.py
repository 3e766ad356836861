"""Fences that are lifted: of the instances that are meant, and of those that still live."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import pytest

from midstride.runtime.records.reports import FencedInstance
from midstride.wire.commands import FenceCommand
from tests.runtime.scripted import REFUSED, Bench, bench, talking

CLOSED = [("out", "/chatter")]


def fence(b: Bench, name: str, how: Literal["gate", "killed"] = "gate") -> None:
    fenced = FencedInstance(instance=name, how=how, because=f"{name} hangs", words=f"{name} was fenced")
    b.client.life.fence(fenced, CLOSED if how == "gate" else [])


def lifted(b: Bench) -> list[tuple[str, FenceCommand]]:
    return [(each.instance, each.command) for each in b.client.sent if isinstance(each.command, FenceCommand)]


def test_only_those_that_are_meant_may_publish_again(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        fence(b, "talker")
        fence(b, "listener")
        fences = b.driver.fences
        await fences.lift(["talker", "stranger"])
        assert lifted(b) == [("talker", FenceCommand(attachments=CLOSED, lift=True))]
        assert b.words("note") == ["talker may publish again"]
        left = "listener was fenced, and its topics are not handed back to it: listener hangs"
        assert list(fences.problems()) == [left]

    bench(talking(), tmp_path, body)


@pytest.mark.parametrize("how", ["killed", "gate"])
def test_one_that_was_killed_or_does_not_answer_stays_fenced(how: Literal["gate", "killed"], tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        fence(b, "talker", how)
        b.client.reply("talker", FenceCommand, REFUSED)
        await b.driver.fences.lift(["talker"])
        assert len(lifted(b)) == (how == "gate") and list(b.client.life.fenced) == ["talker"]
        assert b.words("note") == ([f"talker could not be let publish again: {REFUSED}"] if how == "gate" else [])

    bench(talking(), tmp_path, body)
