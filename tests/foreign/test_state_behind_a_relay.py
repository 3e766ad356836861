"""What a relay keeps and passes on of messages around an import; and that a refusal of it is not forgotten."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from midstride.errors import CommandRefused, ImportRefused
from midstride.foreign.foreign_state import OfferedState
from midstride.foreign.relay import Relay
from midstride.foreign.relayed_state import RelayedState
from midstride.model.contract import Predicate, QoS
from midstride.node.author.declaration import Callbacks
from midstride.node.author.message_times import MessageTimes
from midstride.node.author.ports import Input, Output, OutputLink
from midstride.node.component_host import Host, MessageInfo
from midstride.node.control.state_hooks import StateHooks
from tests.node.author import String

LATCHED = QoS(durability="transient_local", depth=3)


class RelayLab:
    """A relay of one output, behind a closed gate, whose functionality is in its mode: it writes what comes."""

    def __init__(self, rated: bool, qos: QoS = LATCHED) -> None:
        self.time = 0
        self.published: list[str] = []
        self.output = Output("out", String, qos)
        self.owner = SimpleNamespace(info=None)
        self.output.owner = cast(Any, self.owner)
        publisher = cast(Any, SimpleNamespace(publish=lambda message: self.published.append(message.data)))
        self.link = OutputLink(self.output, "/out", publisher, MessageTimes(self.now))
        self.output.links = (self.link,)
        source = Input("out", String, Predicate("std_msgs/msg/String", None, qos))
        self.relay = Relay(source, self.output, "/private", qos, rated)
        self.receive: Callable[[Any, Any], None] = lambda message, info: None
        self.relay.subscribe(cast(Host, self))

    # -- the host

    def now(self) -> int:
        return self.time

    def steady(self) -> int:
        return self.time

    def message_now(self) -> int:
        return self.time

    def read_info(self, info: MessageInfo) -> MessageInfo:
        return info

    def create_subscription(self, topic: str, type_: type, qos: QoS, received: Callable[[Any, Any], None]) -> Any:
        self.receive = received
        return SimpleNamespace()

    async def on_data(self, function: Callable[[], object]) -> object:
        return function()

    # -- the program

    def comes(self, words: str, published: int, entered: bool = True) -> None:
        message, info = String(data=words), MessageInfo(published, None, None)
        self.receive(message, info)
        if entered:
            self.owner.info = info
            self.relay.write(message)

    def kept(self) -> set[str]:
        return {each.data for kept in (self.relay.waiting, self.output.kept, self.link.kept) for each in kept}

    def imports(self, meanwhile: Callable[[], None]) -> None:
        class State:
            async def import_(self, state: bytes, timeout: float) -> None:
                meanwhile()

        state = RelayedState(cast(OfferedState, State()), [self.relay], cast(Host, self))
        asyncio.run(state.import_(b"41", 1.0))


@pytest.mark.parametrize("entered", [True, False])
def test_what_was_published_before_the_import_and_comes_while_it_goes_on_is_not_kept(entered: bool) -> None:
    lab = RelayLab(rated=False)
    lab.comes("before", 10, entered)
    lab.time = 20

    def meanwhile() -> None:
        assert not lab.kept()
        lab.comes("late", 19, entered)
        assert not lab.kept()
        lab.comes("imported", 21, entered)
        lab.time = 30

    lab.imports(meanwhile)
    lab.comes("after", 31, entered)
    assert lab.kept() == {"imported", "after"}
    lab.link.set_gate(True)
    lab.relay.write_waiting()
    assert lab.published == ([] if entered else ["imported", "after"])


@pytest.mark.parametrize("qos", [LATCHED, QoS()])
def test_of_an_output_with_a_rate_nothing_is_kept_that_was_published_before_the_import_has_ended(qos: QoS) -> None:
    lab = RelayLab(rated=True, qos=qos)
    lab.comes("before", 10)
    lab.time = 20

    def meanwhile() -> None:
        lab.comes("meanwhile", 25)
        assert lab.kept() == {"meanwhile"}
        lab.time = 30

    lab.imports(meanwhile)
    assert not lab.kept()
    lab.comes("late", 29)
    assert not lab.kept()
    lab.comes("after", 31)
    assert lab.kept() == {"after"}


def test_a_program_that_has_refused_the_state_is_asked_again_and_one_that_has_not_answered_is_not() -> None:
    answers: list[Exception | None] = [ImportRefused("of another version")] * 2 + [CommandRefused("no answer")]

    class Outside:
        exports = True

        async def require_import(self) -> None:
            pass

        async def import_(self, state: bytes, timeout: float) -> None:
            if (error := answers.pop(0)) is not None:
                raise error

    hooks = StateHooks(Callbacks(outside_state=cast(Any, Outside())), cast(Any, None))

    def imports(exporter: str) -> None:
        asyncio.run(hooks.import_(b"41", 1.0, exporter=exporter))

    for said in ("of another version", "of another version", "no answer", "it may do so yet"):
        with pytest.raises(CommandRefused, match=said):
            imports("a")
    assert not answers
    answers.append(None)
    imports("b")
    imports("b")
    assert not answers
