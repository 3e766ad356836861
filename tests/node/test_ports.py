"""An attachment of an output: what its gate and its fence let pass, and how that is counted."""

from __future__ import annotations

import pytest

from midstride.model.contract import QoS
from midstride.node.author.ports import Output, OutputLink
from midstride.node.author.write_lease import WriteLease
from tests.node.author import String
from tests.node.test_cut import Owner, link_of, write


def passing(link: OutputLink) -> tuple[bool, bool, bool]:
    return link.is_silenced, link.lets_pass, link.is_live


@pytest.mark.parametrize("open_", [True, False])
def test_nothing_passes_a_fence_however_the_gate_is_set_and_it_is_not_counted_as_sent(open_: bool) -> None:
    link, published = link_of(Owner())
    link.set_gate(True)
    write(link, "before")
    link.fence(True)
    assert passing(link) == (True, False, False)
    link.set_gate(open_)
    write(link, "fenced")
    write(link, "fenced")
    assert (published, link.count, link.gated) == (["before"], 1, 2)
    link.fence(False)
    link.set_gate(True)
    write(link, "after")
    assert passing(link) == (False, True, True)
    assert (published, link.count, link.gated) == (["before", "after"], 2, 2)


def test_nothing_passes_once_the_lease_is_over_and_everything_once_it_is_renewed_or_freed() -> None:
    link, published = link_of(Owner())
    now = [0]
    link.lease = lease = WriteLease(lambda: now[0])
    link.follow_lease()
    link.set_gate(True)
    write(link, "without")
    lease.until = 10
    link.follow_lease()
    write(link, "leased")
    now[0] = 10
    assert passing(link) == (True, False, False) and link.gate == "open"  # it is attached as before
    write(link, "over")
    assert (published, link.count, link.gated) == (["without", "leased"], 2, 1)
    link.fence(True)
    lease.until = 20
    link.follow_lease()
    write(link, "fenced")  # which only lifting that ends
    link.fence(False)
    write(link, "renewed")
    now[0] = 30
    write(link, "over again")
    lease.until = None
    link.follow_lease()
    write(link, "freed")
    assert (published, link.count, link.gated) == (["without", "leased", "renewed", "freed"], 4, 3)


def test_what_late_joiners_get_is_what_was_written_even_if_the_author_fills_the_object_again() -> None:
    output, message = Output("map", String, QoS(durability="transient_local", depth=2)), String(data="first")
    for words in ("first", "second"):
        message.data = words
        output.write(message)
    assert [each.data for each in output.kept] == ["first", "second"]


def test_the_last_message_that_the_gate_has_held_back_is_written_for_late_joiners() -> None:
    link, published = link_of(Owner())
    assert not link.write_kept() and published == []
    write(link, "first")
    write(link, "last")
    assert (published, link.gated) == ([], 2)
    assert link.write_kept()
    assert (published, link.count) == (["last"], 1)
