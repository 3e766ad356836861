"""The requests of clients. Every fault in a body is reported with its path."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, ClassVar, Final, TypeVar

import msgspec
from fastapi import HTTPException
from fastapi import Request as HttpRequest

from midstride.codec.form import Form, FormCheck, NonEmptyName, SecondsOrZero, field
from midstride.codec.parameter import ValueForm, values_of
from midstride.codec.reading import decode, parse_json, under
from midstride.errors import SpecificationError
from midstride.model.component import ParameterValue
from midstride.model.diagnostics import Problem
from midstride.plan.forms.request_form import ChangeRequest, request_names
from midstride.plan.request import PlanRequest
from midstride.runtime.change.change_permission import Override
from midstride.runtime.handover.fences import DEFAULT_WAIT

F = TypeVar("F", bound=msgspec.Struct)
T = TypeVar("T")

# The specification of 1,000 nodes has about 150,000 bytes.
LARGEST_BODY: Final = 1_048_576

# How many seeds at most, and how long they may take at most (s).
MOST_SEEDS: Final = 1_000
LONGEST_REHEARSAL: Final = 120.0


def _at_most(limit: float) -> FormCheck:
    """The check of a number that has an upper bound."""
    return lambda value: f"it is more than {limit:g}" if value > limit else None


class Overriding(Form, frozen=True, kw_only=True):
    """A request that may be carried out although the system is locked, or what its changes require does not hold."""

    despite_lock: bool = False
    despite_requirements: bool = False

    @property
    def override(self) -> Override:
        return Override(self.despite_lock, self.despite_requirements)


class SubmittedChange(Overriding, frozen=True):
    """A request to be carried out.

    `expected`: refuse it unless the configuration still has that revision. `verify`: refuse it unless Alloy finds every
    step of the plan safe, and verify the live configuration after each of them. `brief`: the next command does not wait
    until this change has been measured over 20 periods. `wait`: after how many seconds a hung component that is being
    replaced is fenced: replaced although its code does not return. `file`: the one that `to` was read from. `id`: any
    text; the events `waiting` and `command` of this change contain it, and those that follow until the next `command`
    belong to it. `by`: who asks, and for what, for the history. `despite_lock`: also while the system is locked;
    `despite_requirements`: although what its changes require does not hold.
    """

    what: ClassVar[str] = "a change"

    request: ChangeRequest
    expected: int | None = None
    verify: bool = False
    brief: bool = False
    wait: SecondsOrZero = DEFAULT_WAIT
    file: str | None = None
    id: Annotated[str, field("an id", max_length=100)] | None = None
    by: Annotated[str, field("who asks", max_length=200)] | None = None


class ParameterSetting(Overriding, frozen=True):
    """Values to set at run time, all of them or none: of the parameters of a node, by name.

    `id`: as of a change. `by`: who asks, for the history. `despite_lock`: also while the system is locked;
    `despite_requirements`: although what its changes require does not hold.
    """

    what: ClassVar[str] = "a setting of parameters"

    node: NonEmptyName
    parameters: Annotated[dict[str, ValueForm], field("an object of values", min_length=1)]
    id: Annotated[str, field("an id", max_length=100)] | None = None
    by: Annotated[str, field("who asks", max_length=200)] | None = None


class LockRequest(Form, frozen=True, kw_only=True):
    """A lock, under which no command changes the system, but `down`: why, by whom, and until when (unix seconds).

    `holds_recovery`: nor is what has crashed restarted, and what has degraded restored.
    """

    what: ClassVar[str] = "a lock"

    reason: Annotated[str, field("a reason", min_length=1, max_length=500)]
    by: Annotated[str, field("who locks it", min_length=1, max_length=200)]
    until: SecondsOrZero | None = None
    holds_recovery: bool = False


class UnlockRequest(Form, frozen=True):
    """The end of a lock."""

    what: ClassVar[str] = "the end of a lock"

    by: Annotated[str, field("who unlocks it", min_length=1, max_length=200)]


class DeathRequest(Form, frozen=True):
    """The statement that a host which cannot be reached is dead, so that its nodes may be started elsewhere."""

    what: ClassVar[str] = "a dead host"

    host: NonEmptyName
    by: Annotated[str, field("who says so", min_length=1, max_length=200)]


class SubmittedText(Form, frozen=True, kw_only=True):
    """The text of a specification: JSON where `name` ends in `.json`, else the Stride language."""

    what: ClassVar[str] = "a text"

    text: str
    name: Annotated[
        str,
        field("a file's name", "for the diagnostics", pattern=r"^[^\x00]+$", min_length=1, max_length=255),
    ] = "text.stride"


class SubmittedRehearsal(Form, frozen=True, kw_only=True):
    """A change to be rehearsed on the running specification, with faults that are drawn from a seed each time.

    `seeds`: how often; `first`: the first of the seeds. After `seconds` no further one is begun.
    """

    what: ClassVar[str] = "a rehearsal"

    request: ChangeRequest
    seeds: Annotated[int, field("a number of seeds", check=_at_most(MOST_SEEDS), ge=1, le=MOST_SEEDS)] = 20
    first: Annotated[int, field("the first seed", check=_at_most(2**31), ge=0, le=2**31)] = 0
    seconds: Annotated[
        float, field("a number of seconds", check=_at_most(LONGEST_REHEARSAL), gt=0, le=LONGEST_REHEARSAL)
    ] = 30.0


R = TypeVar("R", SubmittedChange, SubmittedRehearsal)


async def read_setting(http: HttpRequest) -> tuple[ParameterSetting, Mapping[str, ParameterValue]]:
    """The setting in the body, and its values. Raises as :func:`read_request` does."""
    return await _read(http, ParameterSetting, lambda form: (form, values_of(form.parameters)), lambda _: ())


async def read_lock(http: HttpRequest) -> LockRequest:
    """The lock in the body. Raises as :func:`read_request` does."""
    return await _read(http, LockRequest, lambda form: form, lambda _: ())


async def read_unlock(http: HttpRequest) -> UnlockRequest:
    """The end of a lock in the body. Raises as :func:`read_request` does."""
    return await _read(http, UnlockRequest, lambda form: form, lambda _: ())


async def read_death(http: HttpRequest) -> DeathRequest:
    """The dead host in the body. Raises as :func:`read_request` does."""
    return await _read(http, DeathRequest, lambda form: form, lambda _: ())


async def read_request(http: HttpRequest) -> PlanRequest:
    """The request in the body. Raises SpecificationError with every fault; HTTPException if the body is too large."""
    return await _read(http, ChangeRequest, ChangeRequest.request, request_names)


async def read_change(http: HttpRequest) -> tuple[SubmittedChange, PlanRequest]:
    """The change in the body, and its request. Raises as :func:`read_request` does."""
    return await _read_with_request(http, SubmittedChange)


async def read_text(http: HttpRequest) -> SubmittedText:
    """The text in the body. Raises as :func:`read_request` does."""
    return await _read(http, SubmittedText, lambda form: form, lambda _: ())


async def read_rehearsal(http: HttpRequest) -> SubmittedRehearsal:
    """The rehearsal in the body. Raises as :func:`read_request` does."""
    form, _ = await _read_with_request(http, SubmittedRehearsal)
    return form


async def _read_with_request(http: HttpRequest, form: type[R]) -> tuple[R, PlanRequest]:
    def names(parts: tuple[R, PlanRequest]) -> Iterable[Problem]:
        return under("request", request_names(parts[1]))

    return await _read(http, form, lambda found: (found, found.request.request()), names)


async def _read(
    http: HttpRequest, form: type[F], build: Callable[[F], T], names: Callable[[T], Iterable[Problem]]
) -> T:
    body = await read_body(http)

    def read() -> T:
        try:
            text = body.decode()
        except UnicodeDecodeError as error:
            raise SpecificationError([Problem("E001", (), f"not JSON: {error}")]) from None
        return decode(parse_json(text), form, build, names)

    return await asyncio.to_thread(read)  # it can take seconds


async def read_body(http: HttpRequest) -> bytes:
    """The body. Raises HTTPException if it is too large."""
    body = bytearray()
    async for chunk in http.stream():
        body += chunk
        if len(body) > LARGEST_BODY:
            raise HTTPException(413, f"the body has more than {LARGEST_BODY} bytes")
    return bytes(body)
