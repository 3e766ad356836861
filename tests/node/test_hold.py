"""Functionalities that are held between two calls, so that several components change their modes at once."""

from __future__ import annotations

from pathlib import Path

import pytest

from .author import Bench, simulate

NODE = """
from midstride import Component

comp = Component("node")
a = comp.create_functionality("a")

async def slow():
    print("slow begins")
    await comp.clock.sleep(1.0)
    print("slow is done")

a.set_normal_mode(slow, rate=0.4)
a.set_degraded_mode(lambda: print("a degraded"))
b = comp.create_functionality("b")
b.set_normal_mode(lambda: print("b"), rate=5)
b.set_degraded_mode(lambda: print("b degraded"))
comp.start()
"""
NORMAL = {"a": "normal", "b": "normal"}


async def started(bench: Bench) -> int:
    """Both are in their normal modes, and have been called once; how many lines the log has."""
    await bench.start("node", NODE)
    await bench.send("node", "modes", modes=NORMAL)
    await bench.sleep(0.1)
    assert bench.log("node")[2:] == ["slow begins", "b"]
    return len(bench.log("node"))


def test_nothing_is_called_until_the_modes_change(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        before = await started(bench)
        await bench.send("node", "hold", functionalities=["a", "b"], seconds=10.0)
        assert bench.log("node")[before:] == ["slow is done"], "the call under way has ended, and `b` waits with `a`"
        await bench.sleep(5.0)
        assert bench.log("node")[before:] == ["slow is done"]
        state = await bench.send("node", "observe")
        assert {name: entry["mode"] for name, entry in state["functionalities"].items()} == NORMAL
        begun = bench.simulator.clock.steady()
        reply = await bench.send("node", "modes", modes={"a": "degraded", "b": "degraded"})
        assert reply["before"] == NORMAL
        assert begun <= reply["at"] / 1e9 <= bench.simulator.clock.steady()
        await bench.sleep(0.1)
        assert bench.log("node")[before + 1 :] == ["a degraded", "b degraded"]
        reply = await bench.send("node", "modes", modes=NORMAL)
        assert reply.get("at") is None, "it ends no hold"
        await bench.sleep(1.3)
        lines = bench.log("node")[before + 3 :]
        assert lines.count("b") > 5 and lines.count("slow is done") == 1, "it is called again"

    simulate(tmp_path, main)


def test_what_does_not_return_in_time_is_not_held(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        before = await started(bench)
        refused = await bench.refusal("node", "hold", functionalities=["a", "b"], seconds=10.0, timeout=0.3)
        assert refused.startswith("user code did not return within 0.3 s (busy: a for ")
        await bench.sleep(3.0)
        lines = bench.log("node")[before:]
        assert lines.count("slow begins") == 1 and lines.count("b") > 10, "both are called as before"

    simulate(tmp_path, main)


def test_a_hold_ends_by_itself_and_on_request(tmp_path: Path) -> None:
    """Who asked for it may be gone."""

    async def main(bench: Bench) -> None:
        await started(bench)
        await bench.sleep(1.0)
        for seconds, ended in ((1.0, False), (10.0, True)):
            await bench.send("node", "hold", functionalities=["b"], seconds=seconds)
            before = bench.log("node").count("b")
            await bench.sleep(0.8)
            assert bench.log("node").count("b") == before
            if ended:
                await bench.send("node", "hold", functionalities=[], seconds=0.0)
            await bench.sleep(1.2)
            assert bench.log("node").count("b") > before + 3

    simulate(tmp_path, main)


def test_the_next_hold_takes_the_place_of_the_one_before(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await started(bench)
        await bench.sleep(1.0)
        await bench.send("node", "hold", functionalities=["b"], seconds=1.0)
        await bench.send("node", "hold", functionalities=["b"], seconds=10.0)
        before = bench.log("node").count("b")
        await bench.sleep(3.0)
        assert bench.log("node").count("b") == before, "the first one's end is not its end"
        await bench.mode("node", "b", "degraded")

    simulate(tmp_path, main)


def test_what_is_not_there_cannot_be_held(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start("node", NODE)
        refused = await bench.refusal("node", "hold", functionalities=["c"], seconds=1.0)
        assert refused == "there is no functionality c; the functionalities are: a, b"

    simulate(tmp_path, main)


LONG = """
import time
from midstride import Component

comp = Component("node")
a = comp.create_functionality("a")

def calibrate():
    print("it begins")
    time.sleep(3.0)
    print("it is done")

a.set_normal_mode(calibrate)
a.set_degraded_mode(lambda: None)
comp.start()
"""


@pytest.mark.parametrize("held", [True, False])
def test_a_mode_change_is_answered_before_the_first_call_of_the_new_mode_has_returned(
    tmp_path: Path, held: bool
) -> None:
    async def main(bench: Bench) -> None:
        await bench.start("node", LONG)
        if held:
            await bench.send("node", "hold", functionalities=["a"], seconds=10.0)
        begun = bench.simulator.clock.steady()
        await bench.mode("node", "a", "normal")
        assert bench.simulator.clock.steady() - begun < 0.5
        await bench.sleep(3.1)
        assert bench.log("node")[-2:] == ["it begins", "it is done"]

    simulate(tmp_path, main)


def test_what_answers_works_again_and_says_so_although_its_thread_was_not_free(tmp_path: Path) -> None:
    """No command follows: the manager sees that it answers."""

    async def main(bench: Bench) -> None:
        await started(bench)
        await bench.sleep(1.0)
        await bench.send("node", "yield", address="")
        await bench.send("node", "mute")
        before = bench.log("node").count("b")
        bench.simulator.faults.hang("node", 3.0)
        await bench.sleep(0.3)
        refused = await bench.refusal("node", "answer", timeout=0.2)
        assert refused.startswith("user code did not return within 0.2 s")
        state = bench.simulator.state("node")
        assert state is not None and state.answers, "it is reported at once"
        assert bench.log("node").count("b") == before
        await bench.sleep(4.0)
        assert bench.log("node").count("b") > before + 3

    simulate(tmp_path, main)
