"""Ports at run time: attaching, gates, detaching, recording; parameters and state."""

from __future__ import annotations

import base64
from typing import Any

from tests.conformance import puppets
from tests.conformance.lab import Lab, assert_unbroken, check


@check
async def attaches_and_detaches(lab: Lab) -> None:
    """Messages pass while both ends are attached; the first after an attach and the last before a detach included."""
    await lab.start("sink", puppets.sink())
    await lab.start("talker", puppets.talker(rate=50))
    await lab.mode("sink", "hear", "normal")
    await lab.mode("talker", "talk", "normal")
    await lab.sleep(0.3)
    await lab.attach("sink", "in", "/chatter")
    assert await lab.received("sink") == []
    await lab.attach("talker", "out", "/chatter", peers=1)
    await lab.eventually("messages pass", lambda: lab.received("sink"), lambda words: len(words) >= 10)
    await lab.shows(publishers=[("/talker", "/chatter")], subscribers=[("/sink", "/chatter")])
    detached = await lab.change("talker", "detach", port="out", topic="/chatter", timeout=5.0)
    assert detached["acknowledged"] is not False, detached
    assert (await lab.read("talker", "observe"))["ports"] == {"out": {}}
    await lab.sleep(0.3)
    numbers = [row[2] for row in await lab.rows("sink")]
    words = await lab.received("sink")
    known = [number for number in numbers if number is not None]
    assert known == list(range(1, len(words) + 1))[-len(known) :] if known else True, numbers
    await lab.sleep(0.3)
    assert await lab.received("sink") == words, "something came after the detach was acknowledged"
    await lab.eventually(
        "its publisher is gone", lab.backend.endpoints, lambda graph: "/talker" not in dict(graph.publishers)
    )
    assert_unbroken(words)


@check
async def counts_behind_a_closed_gate(lab: Lab) -> None:
    """Behind a closed gate everything is counted and nothing passes; opening it lets the next one pass."""
    await lab.start("sink", puppets.sink())
    await lab.start("talker", puppets.talker(rate=50))
    await lab.attach("sink", "in", "/chatter")
    await lab.mode("sink", "hear", "normal")
    await lab.attach("talker", "out", "/chatter", peers=1, gate="closed")
    seen = await lab.read("talker", "await_write", port="out", topic="/chatter", timeout=0.2)
    assert seen == {"gated": 0, "wrong_type": None, "failed": False}
    await lab.mode("talker", "talk", "normal")
    seen = await lab.read("talker", "await_write", port="out", topic="/chatter", timeout=5.0)
    assert seen["gated"] >= 1 and seen["wrong_type"] is None
    await lab.sleep(0.3)
    link = await lab.port("talker", "out", "/chatter")
    assert link["gate"] == "closed" and link["count"] == 0 and link["gated"] >= 10, link
    assert await lab.received("sink") == []
    await lab.shows(publishers=[("/talker", "/chatter")])  # although it is gated
    await lab.change("talker", "gate", port="out", topic="/chatter", gate="open")
    await lab.eventually("messages pass", lambda: lab.received("sink"), lambda words: len(words) >= 5)
    link = await lab.port("talker", "out", "/chatter")
    assert link["gate"] == "open" and link["count"] >= 5, link
    await lab.change("talker", "gate", port="out", topic="/chatter", gate="closed")
    await lab.sleep(0.2)
    words = await lab.received("sink")
    await lab.sleep(0.2)
    assert await lab.received("sink") == words


@check
async def measures_what_passes(lab: Lab) -> None:
    """Both ends report the rate of the messages on their own clock, and how old the last one is."""
    await lab.start("sink", puppets.sink())
    await lab.start("talker", puppets.talker(rate=20))
    await lab.attach("sink", "in", "/chatter")
    await lab.attach("talker", "out", "/chatter", peers=1)
    await lab.mode("talker", "talk", "normal")

    async def measured() -> list[dict[str, Any]]:
        ends = (("talker", "out"), ("sink", "in"))
        return [(await lab.port(*end, "/chatter"))["measured"] for end in ends]

    def about_20(ends: list[dict[str, Any]]) -> bool:
        return all(end["rate"] is not None and 10 < end["rate"] < 25 and end["age"] < 1 for end in ends)

    await lab.eventually("both ends measure about 20 Hz", measured, about_20)
    await lab.mode("talker", "talk", "degraded")
    await lab.eventually("the last message ages", measured, lambda ends: ends[1]["age"] > 0.3)


@check
async def reports_a_wrong_type(lab: Lab) -> None:
    """A write of another type never reaches the middleware; it is reported, and the functionality degrades."""
    await lab.start("talker", puppets.talker(rate=50, wrong_type="out"))
    await lab.attach("talker", "out", "/chatter", gate="closed")
    await lab.mode("talker", "talk", "normal")
    seen = await lab.read("talker", "await_write", port="out", topic="/chatter", timeout=5.0)
    assert seen["gated"] == 0 and "std_msgs/msg/String" in seen["wrong_type"], seen
    await lab.eventually("it degrades", lambda: lab.in_mode("talker", "talk", "degraded"))


@check
async def refuses_impossible_attachments(lab: Lab) -> None:
    """Twice, to a port that is not there, without the peers that must be: refused, and nothing is left behind."""
    await lab.start("talker", puppets.talker())
    assert "put" in await lab.refusal("talker", "attach", port="put", topic="/chatter")
    words = await lab.refusal("talker", "attach", port="out", topic="/chatter", peers=1, timeout=0.5)
    assert "0 of 1" in words, words
    await lab.eventually(
        "its publisher is gone", lab.backend.endpoints, lambda graph: "/talker" not in dict(graph.publishers)
    )
    assert "attached" in await lab.refusal("talker", "detach", port="out", topic="/chatter")
    assert "attached" in await lab.refusal("talker", "gate", port="out", topic="/chatter", gate="open")
    await lab.attach("talker", "out", "/chatter")
    assert "already" in await lab.refusal("talker", "attach", port="out", topic="/chatter")


@check
async def counts_only_compatible_peers(lab: Lab) -> None:
    """A reader that asks for more than is offered is no peer."""
    await lab.start("sink", puppets.sink(durability="transient_local"))
    await lab.start("talker", puppets.talker())
    await lab.attach("sink", "in", "/chatter")
    words = await lab.refusal("talker", "attach", port="out", topic="/chatter", peers=1, timeout=1.0)
    assert "0 of 1" in words, words


@check
async def records_what_comes(lab: Lab) -> None:
    """An input knows its last receipts, and all of them while it records: in order, numbered, with their times."""
    await lab.start("sink", puppets.sink())
    await lab.start("talker", puppets.talker(rate=100))
    await lab.attach("sink", "in", "/chatter")
    await lab.attach("talker", "out", "/chatter", peers=1)
    begun = await lab.change("sink", "record", inputs=["in"], on=True)
    await lab.mode("talker", "talk", "normal")
    await lab.sleep(1.5)
    records = await lab.read("sink", "records", input="in")
    rows = records["rows"]
    assert len(rows) > 100, f"{len(rows)} of 150 receipts were recorded"
    received = [row[0] for row in rows]
    assert received == sorted(received) and begun["now"] < received[0] and received[-1] <= records["now"]
    for column in (1, 2):  # source time and number
        values = [row[column] for row in rows if row[column] is not None]
        assert values == sorted(set(values)) and len(values) in (0, len(rows)), (column, values)
    assert records["publisher_identity"] is (rows[0][3] is not None)
    await lab.change("sink", "record", inputs=["in"], on=False)
    assert 1 <= len(await lab.rows("sink")) <= 64
    assert "nothing" in await lab.refusal("sink", "record", inputs=["nothing"], on=True)


@check
async def keeps_the_latest_message(lab: Lab) -> None:
    """`input.latest` is the newest message since the attach, in whatever mode; None after a detach."""
    await lab.start("sink", puppets.sink(latest=["in"]))
    await lab.start("talker", puppets.talker(rate=50))
    await lab.mode("talker", "talk", "normal")
    await lab.attach("talker", "out", "/chatter")
    assert (await lab.exported("sink"))["latest"] == {"in": "NoneType"}
    await lab.attach("sink", "in", "/chatter", peers=1)
    await lab.eventually(
        "it has heard something",
        lambda: lab.exported("sink"),
        lambda state: state["latest"]["in"].startswith("talker normal"),
    )
    assert await lab.received("sink") == [], "the degraded mode calls nothing"
    await lab.change("sink", "detach", port="in", topic="/chatter")
    assert (await lab.exported("sink"))["latest"] == {"in": "NoneType"}


@check
async def sets_parameters_at_once_or_not_at_all(lab: Lab) -> None:
    await lab.start("steady", puppets.steady(speed=5, name="a"), speed=7)
    assert (await lab.read("steady", "observe"))["parameters"] == {"speed": 7, "name": "a"}
    changed = await lab.change("steady", "set", parameters={"speed": 8, "name": "b"})
    assert changed["before"] == {"speed": 7, "name": "a"}
    assert (await lab.read("steady", "observe"))["parameters"] == {"speed": 8, "name": "b"}
    words = await lab.refusal("steady", "set", parameters={"name": "c", "speed": 13})
    assert "speed cannot be 13" in words, words
    assert "colour" in await lab.refusal("steady", "set", parameters={"name": "d", "colour": "red"})
    await lab.refusal("steady", "set", parameters={"name": "e", "speed": "fast"})


@check
async def carries_state_over(lab: Lab) -> None:
    await lab.start("old", puppets.talker())
    await lab.start("new", puppets.talker(keeps_state=True))
    await lab.mode("old", "talk", "normal")
    await lab.eventually("it has been called", lambda: lab.calls("old", "talk.normal"))
    await lab.mode("old", "talk", "degraded")
    state = (await lab.read("old", "export_state"))["state"]
    await lab.change("new", "import_state", state=state)
    assert (await lab.exported("new"))["imported"]["calls"] == (await lab.exported("old"))["calls"]
    assert "on_import_state" in await lab.refusal("old", "import_state", state=state)
    assert "state" in await lab.refusal("new", "import_state", state="{not base64}")
    broken = base64.b64encode(b"{").decode()
    assert "JSONDecodeError" in await lab.refusal("new", "import_state", state=broken)
    assert "out" in await lab.read_refusal("old", "records", input="out")
