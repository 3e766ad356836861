"""The instance of a role that answers requests to its node's services: the manager's part.

The components do it among themselves (:mod:`midstride.node.control.service_answering`); the manager says when.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from msgspec import structs

from midstride.errors import CallTimeout, CommandRefused, RevisionChanged, Unreachable
from midstride.model.component import DEFAULT_STOP
from midstride.runtime.process.component_client import ComponentClient
from midstride.wire.commands import AnswerCommand, JoinRequestsCommand

# How long an instance may take to answer, where the one before has the usual time for what it has taken (s).
ANSWERS_WITHIN: Final = 2.0
# How often an instance is asked to answer where it could not, and how long after the last attempt (s): one of the two
# may have got no processor, or a request may be lost. If its predecessor has stopped, and its reply was late, none
# answers until the next attempt; and without any, what has waited would be dropped once the predecessor has ended. None
# answers either where a successor that is gone had it stop.
ATTEMPTS: Final = 3
AGAIN: Final = 0.5


async def have_answer(
    client: ComponentClient, instance: str, instead_of: str | None = None, drain: float = DEFAULT_STOP.drain
) -> str | None:
    """Have ``instance`` answer requests, unless it reports that it does. Raises MidstrideError, after some attempts.

    ``instead_of`` is the running instance that has answered until now, and has ``drain`` (s) to answer what it has
    taken; None if there is none. Returns what it had not answered then, in words; None if nothing.
    """
    concerned = [instance] if instead_of is None else [instance, instead_of]
    for _ in range(ATTEMPTS - 1):
        try:
            return await _ask(client, instance, instead_of, drain)
        except (CallTimeout, CommandRefused, Unreachable):
            # One that is stopped, or gone, does not do its part at the next attempt either.
            if not _all_respond(client, concerned):
                raise
            await client.clock.sleep(AGAIN)
            if not _all_respond(client, concerned):
                raise
    return await _ask(client, instance, instead_of, drain)


def _all_respond(client: ComponentClient, instances: Sequence[str]) -> bool:
    return all(client.life.responsive(each) is not None for each in instances)


async def _ask(client: ComponentClient, instance: str, instead_of: str | None, drain: float) -> str | None:
    """One attempt of :func:`have_answer`."""
    latest = client.life.latest(instance)
    if latest is not None and latest.state.answers:
        return None
    if latest is not None and client.life.responsive(instance) is None:
        raise CallTimeout(f"{instance} reports nothing")  # what waits for it would only be late
    address = None if instead_of is None else client.address(instead_of, instance)
    own_address = "" if instead_of is None else client.address(instance, instead_of)
    timeout = ANSWERS_WITHIN + max(0.0, drain - DEFAULT_STOP.drain)
    command = AnswerCommand(peer=instead_of or "", address=address, drain=drain, timeout=timeout)
    if own_address != client.address(instance):  # on another host; an earlier version has no other ones
        command = structs.replace(command, own_address=own_address)
    try:
        answers = await client.change(instance, command)
    except RevisionChanged:  # what an earlier manager has asked it to do has just ended
        client.forget_revision(instance)
        answers = await client.change(instance, command)
    if answers.first is not None and instead_of is not None:
        await client.change(instead_of, JoinRequestsCommand(place=answers.first))
        answers = await client.change(instance, command)
    if not (left := answers.outlasting):
        return None
    what = f"{left} request{'' if left == 1 else 's'} that it had taken"
    return f"{instance} answers requests; {instead_of} has not answered {what} within the {drain:g} s of `drain`"
