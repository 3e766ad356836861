"""Modes: what is called when, changes between two calls, time-outs, and code that raises."""

from __future__ import annotations

from tests.conformance import puppets
from tests.conformance.lab import Lab, check


@check
async def calls_at_its_rate(lab: Lab) -> None:
    """The first call comes on entry, the others on the grid; a degraded mode without rate is called once."""
    await lab.start("talker", puppets.talker(rate=50))
    assert (await lab.exported("talker"))["calls"] == {"talk.degraded": 1}
    assert await lab.mode("talker", "talk", "normal") == {"before": {"talk": "degraded"}, "at": None}
    await lab.eventually("the first call comes", lambda: lab.calls("talker", "talk.normal"))
    grid = await lab.read("talker", "grid", port="out")
    assert grid["trigger"] == "rate" and grid["period"] == 0.02 and grid["epoch"] <= grid["now"], grid
    before, begun = await lab.calls("talker", "talk.normal"), lab.clock.steady()
    await lab.sleep(2.0)
    after, seconds = await lab.calls("talker", "talk.normal"), lab.clock.steady() - begun
    # A loaded machine skips slots; it never adds any.
    assert 0.5 * 50 <= (after - before) / seconds <= 1.1 * 50, f"{after - before} calls in {seconds} s"
    later = await lab.read("talker", "grid", port="out")
    slots = (later["epoch"] - grid["epoch"]) / 20e6
    assert abs(slots - round(slots)) < 1e-3 and slots > 90, "a slot off the grid"
    assert await lab.mode("talker", "talk", "degraded") == {"before": {"talk": "normal"}, "at": None}
    calls = await lab.exported("talker")
    await lab.sleep(0.2)
    assert await lab.exported("talker") == calls and calls["calls"]["talk.degraded"] == 2
    assert (await lab.read("talker", "grid", port="out"))["trigger"] == "none"


@check
async def calls_for_every_message(lab: Lab) -> None:
    """A message-driven mode answers each message once, in order; its output's grid is the messages'."""
    await lab.listen()
    await lab.start("relay", puppets.relay())
    await lab.start("source", puppets.talker(rate=100))
    await lab.attach("relay", "out", "/chatter", peers=1)
    await lab.attach("relay", "in", "/questions")
    await lab.attach("source", "out", "/questions", peers=1)
    await lab.mode("relay", "answer", "normal")
    await lab.mode("source", "talk", "normal")
    assert (await lab.read("relay", "grid", port="out"))["trigger"] == "message"
    await lab.sleep(1.0)
    await lab.mode("source", "talk", "degraded")
    await lab.sleep(0.3)
    asked = await lab.calls("source", "talk.normal")
    assert await lab.received("sink") == [f"source normal {n}" for n in range(1, asked + 1)]


@check
async def changes_modes_between_two_calls(lab: Lab) -> None:
    """A degrade waits for the call under way; what that writes still arrives, and nothing after the acknowledgement."""
    await _start_slow(lab, {"sleep": 1.5})
    begun = lab.clock.steady()
    busy = await lab.functionality("slow", "talk")
    assert lab.clock.steady() - begun < 0.5, "observe waited for user code"
    assert busy["mode"] == "normal" and 0 < busy["busy"] < 1.5, busy
    await _degrades_after_its_call(lab)
    assert (await lab.functionality("slow", "talk"))["busy"] is None


async def _start_slow(lab: Lab, mode: puppets.Description) -> None:
    """``slow`` talks to ``sink``; its first call is under way."""
    await lab.listen()
    await lab.start("slow", puppets.talker(rate=2, mode=mode))
    await lab.attach("slow", "out", "/chatter", peers=1)
    await lab.mode("slow", "talk", "normal")
    await lab.sleep(0.3)


async def _degrades_after_its_call(lab: Lab) -> None:
    """``slow`` refuses to degrade while its call takes longer than the time-out; what it writes until then arrives."""
    words = await lab.refusal("slow", "modes", modes={"talk": "degraded"}, timeout=0.2)
    assert "talk" in words and "0.2" in words, words
    await lab.sleep(2.5)  # a change that was withdrawn must not happen later
    assert (await lab.functionality("slow", "talk"))["mode"] == "normal"
    await lab.mode("slow", "talk", "degraded", timeout=5.0)
    await lab.sleep(0.2)  # for messages on their way
    arrived = await lab.received("sink")
    assert arrived, "its calls never ended"
    await lab.sleep(2.0)
    assert await lab.received("sink") == arrived, "something arrived after the degrade was acknowledged"


@check
async def counts_an_async_call_as_running(lab: Lab) -> None:
    """An async mode function keeps its mode from ending until it returns, and blocks no other call."""
    await _start_slow(lab, {"pause": 1.5})
    assert (await lab.functionality("slow", "talk"))["busy"] > 0
    await lab.exported("slow")  # the data thread is free meanwhile
    await _degrades_after_its_call(lab)


@check
async def refuses_unknown_modes(lab: Lab) -> None:
    await lab.start("talker", puppets.talker())
    assert "sing" in await lab.refusal("talker", "modes", modes={"sing": "normal"})
    words = await lab.refusal("talker", "modes", modes={"talk": "loud"})
    assert "loud" in words and "normal, degraded" in words, words
    before = await lab.functionality("talker", "talk")
    assert await lab.mode("talker", "talk", "degraded") == {"before": {"talk": "degraded"}, "at": None}
    after = await lab.functionality("talker", "talk")
    assert after["because"] == before["because"], "a change to its current mode must change nothing"


@check
async def degrades_where_user_code_raises(lab: Lab) -> None:
    """The process goes on; the functionality goes to its last mode at once, with the reason; the revision changes."""
    await lab.start("talker", puppets.talker(rate=20, mode={"raise": "division of labour", "at_call": 3}))
    await lab.mode("talker", "talk", "normal")
    revision = (await lab.read("talker", "observe"))["revision"]
    await lab.eventually("it degrades", lambda: lab.in_mode("talker", "talk", "degraded"))
    state = await lab.read("talker", "observe")
    because = state["functionalities"]["talk"]["because"]
    assert "division of labour" in because and "puppet.py" in because, because
    assert state["revision"] == revision + 1, "the manager cannot see that something happened"
    assert (await lab.exported("talker"))["calls"] == {"talk.degraded": 2, "talk.normal": 3}
    await lab.mode("talker", "talk", "normal")
    await lab.sleep(0.3)
    assert (await lab.functionality("talker", "talk"))["mode"] == "normal", "it raises only once"


@check
async def survives_a_last_mode_that_raises(lab: Lab) -> None:
    description = puppets.talker()
    description["modes"]["talk.degraded"] = {"raise": "not even this"}
    await lab.start("talker", description)
    state = await lab.functionality("talker", "talk")
    assert state["mode"] == "degraded" and "not even this" in state["because"], state
    await lab.mode("talker", "talk", "normal")
    await lab.eventually("it works", lambda: lab.calls("talker", "talk.normal"))
