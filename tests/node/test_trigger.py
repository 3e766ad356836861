"""Sets of messages, with the messages in the test's hands."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

from midstride.model.contract import Predicate
from midstride.node.author.modes import Approximate, DeclaredMode
from midstride.node.author.ports import Input
from midstride.node.component_host import Host
from midstride.node.data.trigger import InfoSet, OnSet

from .author import Image

MS = 1_000_000


class Recorder:
    """A functionality that notes its calls: the widths of the images of each."""

    def __init__(self) -> None:
        self.watch: Callable[[Any], None] | None = None
        self.calls: list[tuple[int, ...]] = []
        self.infos: list[Any] = []

    def call(self, function: Any, arguments: tuple[Any, ...], slots: Any, info: Any) -> None:
        assert slots is None
        self.calls.append(tuple(image.width for image in arguments))
        self.infos.append(info)

    request = call


def inputs(runner: Recorder, slop: float = 0.04) -> tuple[Input, Input]:
    """Two inputs whose messages are called together."""
    assumption = Predicate("sensor_msgs/msg/Image")
    left, right = Input("left", Image, assumption), Input("right", Image, assumption)
    mode = DeclaredMode(
        "normal",
        "message",
        print,
        None,
        ((left,), (right,)),
        (),
        {},
        sync=Approximate(slop, 10),
        synchronised=(left, right),
    )
    OnSet(runner, cast(Host, None), mode).begin()
    return left, right


def send(port: Input, time: int, width: int) -> None:
    """An image stamped ``time`` (ms)."""
    image = Image(width=width)
    image.header.stamp.sec, image.header.stamp.nanosec = divmod(time * MS, 10**9)
    for listener in port.listeners:
        listener(image, f"info {width}")


def test_a_message_is_in_one_set_only() -> None:
    runner = Recorder()
    left, right = inputs(runner)
    send(left, 100, 1)
    send(right, 100, 2)
    assert runner.calls == [(1, 2)] and runner.infos == [InfoSet(("info 1", "info 2"))]
    send(right, 110, 3)  # within the slop of the left one, which has had its call
    send(left, 120, 4)
    assert runner.calls == [(1, 2), (4, 3)]


def test_every_message_is_watched_during_a_cut_whether_it_completes_a_set_or_not() -> None:
    runner = Recorder()
    left, right = inputs(runner)
    send(left, 100, 1)
    watched: list[Any] = []
    runner.watch = watched.append
    send(right, 300, 2)
    send(left, 310, 3)
    assert watched == ["info 2", "info 3"] and runner.calls == [(3, 2)]
