"""The lease of a component with a fallback on another host: what the manager's renewals do to it, in virtual time."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any, cast

from midstride.backends.simulator.virtual_loop import run
from midstride.model.contract import DEFAULT_QOS, QoS
from midstride.node.author.message_times import MessageTimes
from midstride.node.author.ports import Output, OutputLink
from midstride.node.author.write_lease import WriteLease
from midstride.node.control.lease_commands import Leasing
from midstride.wire.commands import KeepLeaseCommand
from tests.node.author import String


class Publisher:
    """``missing``: a reader lacks what was published."""

    def __init__(self) -> None:
        self.sent: list[str] = []
        self.missing = self.gone = False

    def publish(self, message: Any) -> None:
        self.sent.append(message.data)

    async def acknowledged(self, timeout: float) -> bool | None:
        return None if self.missing else True

    def destroy(self) -> None:
        self.gone = True


class Data:
    async def run(self, function: Callable[[], Any], timeout: float) -> Any:
        return function()


class Component:
    """A component with one output, whose gate is open; ``made``: its publishers, the last one is in use."""

    def __init__(self, qos: QoS = DEFAULT_QOS) -> None:
        loop = asyncio.get_running_loop()
        self.made: list[Publisher] = []
        self.changes = 0
        self.output = Output("out", String, qos)
        self.output.owner = cast(Any, SimpleNamespace(driven="rate"))
        host = SimpleNamespace(
            steady=lambda: round(loop.time() * 1e9),
            sleep=asyncio.sleep,
            create_publisher=lambda topic, type_, qos: self.publisher(),
            logger=logging.getLogger("test"),
            instance="talker",
        )
        parts = SimpleNamespace(outputs={"out": self.output})
        attachments = SimpleNamespace(parts=parts, lease=WriteLease(host.steady))
        self.link = OutputLink(
            self.output, "/chatter", cast(Any, self.publisher()), MessageTimes(host.steady), attachments.lease
        )
        self.link.set_gate(True)
        self.output.links = (self.link,)
        self.leasing = Leasing(cast(Any, attachments), cast(Any, host), cast(Any, Data()), self.changed)

    def publisher(self) -> Publisher:
        self.made.append(Publisher())
        return self.made[-1]

    def changed(self) -> None:
        self.changes += 1

    def write(self, words: str) -> None:
        self.output.write(String(data=words))

    @property
    def sent(self) -> list[str]:
        return [words for each in self.made for words in each.sent]

    async def ask(self) -> int:
        return (await self.leasing.keep(KeepLeaseCommand(seconds=2.0))).now

    async def renew(self, seen: int, seconds: float | None = 2.0) -> None:
        await self.leasing.keep(KeepLeaseCommand(seconds=seconds, seen=seen))


def acting(act: Callable[[Component], Awaitable[None]], qos: QoS = DEFAULT_QOS) -> None:
    async def body() -> None:
        await act(Component(qos))

    run(body())


def test_a_lease_lasts_from_the_moment_that_the_component_has_stated_however_late_the_renewal_is() -> None:
    async def act(component: Component) -> None:
        seen = await component.ask()
        await asyncio.sleep(60)
        component.write("without a lease")
        seen = await component.ask()
        await asyncio.sleep(1.5)
        await component.renew(seen)
        component.write("leased")
        await asyncio.sleep(0.6)
        component.write("over")
        await component.renew(seen)  # the link delivers it once more
        component.write("still over")
        await component.renew(await component.ask())
        component.write("renewed")
        assert component.sent == ["without a lease", "leased", "renewed"]
        assert component.changes == 2  # when it was over, and when it was renewed

    acting(act)


def test_an_earlier_renewal_or_release_that_is_delivered_late_changes_nothing() -> None:
    async def act(component: Component) -> None:
        first = await component.ask()
        await asyncio.sleep(0.5)
        await component.renew(await component.ask())
        await component.renew(first, seconds=None)
        await component.renew(first)
        await asyncio.sleep(1.8)  # from the first moment, it would be over
        component.write("leased")
        await asyncio.sleep(0.3)
        component.write("over")
        await component.renew(await component.ask(), seconds=None)
        await asyncio.sleep(60)
        component.write("freed")
        assert component.sent == ["leased", "freed"]

    acting(act)


def test_what_the_middleware_has_not_delivered_when_the_lease_is_over_is_never_delivered() -> None:
    async def act(component: Component) -> None:
        await component.renew(await component.ask())
        component.write("not delivered")
        component.made[0].missing = True
        await asyncio.sleep(2.1)
        assert [each.gone for each in component.made] == [True, False]
        component.write("over")
        await component.renew(await component.ask())
        component.write("renewed")
        assert component.made[1].sent == ["renewed"]
        await asyncio.sleep(2.1)
        assert len(component.made) == 2  # all has arrived

    acting(act)


def test_late_joiners_get_what_was_written_while_the_lease_was_over_once_it_is_renewed() -> None:
    async def act(component: Component) -> None:
        await component.renew(await component.ask())
        await asyncio.sleep(2.1)
        component.write("map")
        await component.renew(await component.ask())
        assert component.sent == ["map"] and component.link.count == 1

    acting(act, QoS(durability="transient_local", depth=1))
