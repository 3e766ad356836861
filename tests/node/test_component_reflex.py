"""The watch over one functionality: what of its inputs is broken, in which words, and which mode is the next."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

from midstride.backends.simulator.virtual_loop import run
from midstride.node.control.component_reflex import LONGEST, SETTLING, Reflex, Watch
from midstride.node.control.shortfall import FLOOR, LONG_FLOOR
from tests.node.virtual import VirtualHost, seconds

RATE = 10.0


@dataclass(eq=False)
class Link:
    topic: str = "/chatter"
    publishers: int = 1
    lets_pass: bool = True

    @property
    def endpoint(self) -> Any:
        return SimpleNamespace(matched=lambda: self.publishers)


@dataclass(eq=False)
class Port:
    """An input or an output as the watch sees it."""

    name: str = "in"
    count: int = 1
    rate: float | None = RATE
    tolerates: int | None = 4
    recording: bool = False
    denied: bool = False
    condition: bool = False
    violations: list[str] = field(default_factory=list)
    links: list[Link] = field(default_factory=lambda: [Link()])
    turned: Callable[[], object] | None = None

    @property
    def attached(self) -> bool:
        return bool(self.links)


def mode(name: str, *groups: tuple[Port, ...], outputs: tuple[Port, ...] = ()) -> Any:
    return SimpleNamespace(name=name, assumptions=groups, outputs=outputs)


def runner(chain: list[Any], index: int = 0, **more: Any) -> Any:
    ports = dict.fromkeys(port for each in chain for group in each.assumptions for port in group)
    fields = {"entered": 1, "switching": False, "asynchronous": False, "busy": None, "name": "work"} | more
    return SimpleNamespace(
        chain=chain, index=index, last=len(chain) - 1, mode=chain[index], inputs=tuple(ports), **fields
    )


def watching(*groups: tuple[Port, ...], second: tuple[Port, ...] = ()) -> Any:
    """A mode that assumes ``groups``, a second one that assumes ``second``, and the degraded one."""
    return Watch(runner([mode("normal", *groups), mode("second", second), mode("degraded")]))


# -- what is broken ----------------------------------------------------------------------------------------


def test_of_alternatives_all_that_were_ever_received_have_to_break() -> None:
    one, other, single = Port("one"), Port("other"), Port("single")
    watch = watching((one, other), (single,))
    assert watch.broken_assumption(1.0) == []
    one.denied = True
    assert watch.broken_assumption(1.0) == []
    other.count = 0  # it has never come, so nothing is lost with it
    assert watch.broken_assumption(1.0) == [one]
    other.count = 1
    single.denied = True
    assert watch.broken_assumption(1.0) == [single]
    other.denied = True
    assert watch.broken_assumption(1.0) == [one, other], "the first assumption that does not hold"


@pytest.mark.parametrize(("publishers", "gone"), [((1, 1), False), ((0, 1), False), ((0, 0), True)])
def test_a_publisher_is_called_gone_where_the_input_has_none_on_any_topic(
    publishers: tuple[int, ...], gone: bool
) -> None:
    port = Port(links=[Link("/a", publishers[0]), Link("/b", publishers[1])])
    watch = watching((port,))
    watch.advance(2.0)
    words = watch.why(port, 1.0)
    assert words.startswith("input in received nothing on /a, /b for 2.00 s"), words
    assert words.endswith("(10 Hz is assumed; silence is tolerated for 1 s)"), words
    assert ("and its publisher is gone" in words) is gone


def test_a_condition_that_does_not_hold_is_named_with_its_values() -> None:
    port = Port("docked", rate=None, condition=True, denied=True, violations=["data is False", "not now"])
    words = watching((port,)).why(port, 1.0)
    assert words == "condition docked does not hold on /chatter: data is False; not now"


def test_constraints_that_messages_have_not_met_are_named() -> None:
    port = Port(violations=["width is 3"])
    watch = watching((port,))
    watch.advance(2.0)
    assert "received nothing that meets its constraints (width is 3) on /chatter" in watch.why(port, 1.0)


# -- the next mode -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("port", "relied", "index"),
    [
        (Port(), False, 1),
        (Port(count=0), False, 2),  # it has not been received
        (Port(denied=True), False, 2),
        (Port(rate=None), False, 2),  # nothing is known of it
        (Port(rate=None), True, 1),  # it is as good as it was
        (Port(rate=None, links=[]), True, 2),
        (Port(rate=None, condition=True), False, 1),
        (Port(rate=None, condition=True, count=0), False, 2),
    ],
)
def test_the_next_mode_is_the_best_whose_inputs_are_known_to_be_in_order(port: Port, relied: bool, index: int) -> None:
    broken = Port("broken", denied=True)
    groups = [(broken,), (port,)] if relied else [(broken,)]
    assert watching(*groups, second=(port,)).next_mode(1.0) == index


@pytest.mark.parametrize(("silence", "index"), [(0.4, 1), (0.6, 2)])
def test_an_input_that_lacks_half_of_what_is_tolerated_is_not_in_order(silence: float, index: int) -> None:
    """Five periods are tolerated, but at first a second."""
    port = Port()
    watch = watching((Port("broken", denied=True),), second=(port,))
    watch.inputs[port].advance(silence * RATE, port.count)
    assert watch.next_mode(1.0) == index


# -- a call that hangs -------------------------------------------------------------------------------------


class Scene:
    """A functionality with an output at 10 Hz on which nothing is written any more, and its reflex."""

    def __init__(self, **more: Any) -> None:
        self.out = Port("out")
        normal = mode("normal", outputs=(self.out,))
        self.runner = runner([normal, mode("degraded")], **more)
        self.commanded = False
        self.free = asyncio.Event()  # the data thread
        host = VirtualHost()
        host.on_data = self.on_data  # type: ignore[assignment, method-assign]
        self.reflex = Reflex(host.host, [self.runner], lambda: self.commanded, lambda _: None, lambda: None)
        self.watch: Any = Watch(self.runner)

    async def on_data(self, function: Callable[[], object]) -> object:
        await self.free.wait()
        return function()

    def probes(self) -> bool:
        """Whether it waits for the data thread to become free."""
        return self.watch.probe is not None

    async def goes_by(self, gone: float) -> str | None:
        await asyncio.sleep(gone)
        self.watch.advance(gone)
        return self.reflex._hang(self.watch, 1.0)


def test_a_data_thread_that_is_busy_for_as_long_as_is_tolerated_hangs() -> None:
    async def main() -> None:
        scene = Scene(busy=0)
        assert await scene.goes_by(0.5 * LONG_FLOOR - 0.1) is None and not scene.probes()
        assert await scene.goes_by(0.2) is None and scene.probes()
        assert await scene.goes_by(0.5 * LONG_FLOOR - 0.2) is None
        words = await scene.goes_by(0.2)
        assert words == (
            "mode normal wrote nothing on output out for 5.10 s instead of 10 Hz: "
            "a call of work has not returned for 5.10 s"
        )

    run(main())


def test_a_data_thread_that_a_command_has_kept_busy_has_a_moment_to_become_free() -> None:
    async def main() -> None:
        scene = Scene()
        scene.commanded = True
        assert await scene.goes_by(2 * LONG_FLOOR) is None and not scene.probes()
        scene.commanded = False
        assert await scene.goes_by(0.01) is None
        assert await scene.goes_by(0.39 * FLOOR) is None
        words = await scene.goes_by(0.02 * FLOOR)
        assert words is not None and words.endswith("user code occupies its thread")

    run(main())


@pytest.mark.parametrize("asynchronous", [False, True])
def test_calls_that_return_without_a_write_are_no_hang_but_an_async_call_that_waits_is(asynchronous: bool) -> None:
    async def main() -> None:
        scene = Scene(asynchronous=asynchronous)
        scene.free.set()
        assert await scene.goes_by(0.6 * LONG_FLOOR) is None
        words = await scene.goes_by(0.6 * LONG_FLOOR)
        assert (words is not None) is asynchronous
        assert scene.watch.outputs[scene.out].silent == (0.0 if not asynchronous else pytest.approx(60.0))

    run(main())


# -- how often it looks ------------------------------------------------------------------------------------


def test_it_wakes_as_soon_as_a_condition_has_turned_and_else_after_its_pause() -> None:
    async def main() -> None:
        scene = Scene()
        assert await scene.reflex._pause(0.5) is False
        assert seconds() == pytest.approx(0.5), "there is no condition"
        condition = Port("docked", rate=None, condition=True)
        scene.runner.inputs = (condition,)
        assert await scene.reflex._pause(0.5) is False
        assert seconds() == pytest.approx(0.5 + LONGEST)
        asyncio.get_running_loop().call_later(0.02, scene.reflex._changed.set)
        assert await scene.reflex._pause(0.5) is True
        assert seconds() == pytest.approx(0.5 + LONGEST + 0.02 + SETTLING)
        assert await scene.reflex._pause(0.05) is False

    run(main())
