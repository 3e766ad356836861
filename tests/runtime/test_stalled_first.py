"""A change replaces nodes whose middleware has stopped discovering before all others, where it concerns them."""

from __future__ import annotations

from dataclasses import replace

import pytest
from immutables import Map

from midstride.model.configuration import Configuration
from midstride.model.specification import Node, Order, Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.change.stalled_first import with_stalled_first
from tests.model import build
from tests.runtime.scripted import LISTENER, TALKER, talking

RESTART = PlanRequest(restart=("talker",))
WORDS = ("listener is replaced first: its middleware discovers no new endpoints",)


def specification(*roles: str) -> Specification:
    of = {"talker": TALKER, "listener": LISTENER}
    return Specification("chat", nodes=Map({role: Node(role, of[role].name, Map()) for role in roles}))


@pytest.mark.parametrize(
    ("request_", "stopped", "also"),
    [
        (PlanRequest(restart=("talker", "listener")), ["listener"], ()),  # it is replaced anyway
        (PlanRequest(to=specification("talker", "listener")), ["listener"], ("listener",)),
    ],
)
def test_one_that_is_stalled_is_replaced_before_what_it_exchanges_messages_with(
    request_: PlanRequest, stopped: list[str], also: tuple[str, ...]
) -> None:
    wanted = replace(request_, restart=(*request_.restart, *also))
    order = (Order("listener", "talker"),)
    assert with_stalled_first(request_, talking(), stopped) == (wanted, order, WORDS)


def test_a_change_of_its_partner_replaces_it_too() -> None:
    found, orders, words = with_stalled_first(RESTART, talking(), ["listener"])
    assert (found.restart, orders, words) == (("talker", "listener"), (Order("listener", "talker"),), WORDS)


@pytest.mark.parametrize(
    ("request_", "stopped", "configuration"),
    [
        (RESTART, [], talking()),
        (RESTART, ["gone"], talking()),
        (RESTART, ["talker"], talking()),  # its partner stays
        (RESTART, ["listener"], talking(listener=build.sink("Listener"))),  # no manager can start it
        (PlanRequest(restart=("talker",), remove=("listener",)), ["listener"], talking()),  # it goes
        (PlanRequest(to=specification("talker")), ["listener"], talking()),  # it is no part of what is to run
        (PlanRequest(restart=("listener",)), ["listener"], talking()),
    ],
)
def test_one_that_the_change_does_not_concern_is_left_alone(
    request_: PlanRequest, stopped: list[str], configuration: Configuration
) -> None:
    assert with_stalled_first(request_, configuration, stopped) == (request_, (), ())


def test_a_new_node_on_its_topic_is_a_partner() -> None:
    recorder = Node("recorder", "Listener", Map({"in": ("/chatter",)}))
    for name in ("talker", "listener"):
        found, orders, _ = with_stalled_first(PlanRequest(add=(recorder,)), talking(), [name])
        assert (found.restart, orders) == ((name,), (Order(name, "recorder"),))
    elsewhere = replace(recorder, attachments=Map({"in": ("/other",)}))
    assert with_stalled_first(PlanRequest(add=(elsewhere,)), talking(), ["talker"])[1] == ()


def test_of_two_that_are_stalled_neither_waits_for_the_other() -> None:
    both = PlanRequest(restart=("talker", "listener"))
    found, orders, words = with_stalled_first(both, talking(), ["talker", "listener"])
    assert (found, orders) == (both, ()) and len(words) == 2
