"""Which instance of a role answers requests to its node's services: the manager's part.

The components do it among themselves (:mod:`midstride.node.control.service_answering`); the manager says when.
"""

from __future__ import annotations

from typing import Final

from midstride.errors import CallTimeout, CommandRefused, RevisionChanged
from midstride.model.component import DEFAULT_STOP
from midstride.runtime.process.component_client import ComponentClient
from midstride.wire.commands import AnswerCommand

# How long an instance may take to answer, where the one before has the usual time for what it has taken (s).
ANSWERS_WITHIN: Final = 2.0
# How often an instance is asked to answer where it could not, and how long after the last attempt (s): one of the two
# may have got no processor. If its predecessor has stopped, and its reply was late, none answers until the next
# attempt; and without any, what has waited would be dropped once the predecessor has ended.
ATTEMPTS: Final = 3
AGAIN: Final = 0.5


async def have_answer(
    client: ComponentClient, instance: str, instead_of: str | None = None, drain: float = DEFAULT_STOP.drain
) -> str | None:
    """Have ``instance`` answer requests, unless it reports that it does. Raises MidstrideError, after some attempts.

    ``instead_of`` is the running instance that has answered until now, and has ``drain`` (s) to answer what it has
    taken; None if there is none. Returns what it had not answered then, in words; None if nothing.
    """
    for _ in range(ATTEMPTS - 1):
        if instead_of is None:  # nothing has stopped, so nothing waits for another attempt
            break
        try:
            return await _ask(client, instance, instead_of, drain)
        except (CallTimeout, CommandRefused):
            await client.clock.sleep(AGAIN)
            # One that is stopped, or hangs, does not do its part at the next attempt either.
            if any(client.life.responsive(each) is None for each in (instance, instead_of)):
                raise
    return await _ask(client, instance, instead_of, drain)


async def _ask(client: ComponentClient, instance: str, instead_of: str | None, drain: float) -> str | None:
    """One attempt of :func:`have_answer`."""
    latest = client.life.latest(instance)
    if latest is not None and latest.state.answers:
        return None
    if latest is not None and client.life.responsive(instance) is None:
        raise CallTimeout(f"{instance} reports nothing")  # what waits for it would only be late
    address = None if instead_of is None else client.address(instead_of)
    timeout = ANSWERS_WITHIN + max(0.0, drain - DEFAULT_STOP.drain)
    command = AnswerCommand(peer=instead_of or "", address=address, drain=drain, timeout=timeout)
    try:
        answers = await client.change(instance, command)
    except RevisionChanged:  # what an earlier manager has asked it to do has just ended
        client.forget_revision(instance)
        answers = await client.change(instance, command)
    if not (left := answers.outlasting):
        return None
    what = f"{left} request{'' if left == 1 else 's'} that it had taken"
    return f"{instance} answers requests; {instead_of} has not answered {what} within the {drain:g} s of `drain`"
