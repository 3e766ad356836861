"""What comes in over HTTP, checked at the edge; what goes out, described for the OpenAPI document.

Incoming documents are strict: an unknown key is a fault with its path. Outgoing ones are written
by the manager and only described here (fields may be added), so nothing is lost or slowed on the way.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from midstride.plan.request import Request


class Incoming(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Outgoing(BaseModel):
    model_config = ConfigDict(extra="allow")


class NewNode(Incoming):
    """A node to add: its role, its component, and the topics its ports are attached to."""

    role: str
    component: str
    attachments: dict[str, list[str]] = Field(default_factory=dict, description="port -> topics")
    parameters: dict[str, Any] = Field(default_factory=dict)


class ChangeRequest(Incoming):
    """What is asked for: single changes, or a whole specification (`to`) to change to."""

    replace: list[tuple[str, str]] = Field(default_factory=list, description="[node, component] pairs")
    add: list[NewNode] = Field(default_factory=list)
    remove: list[str] = Field(default_factory=list, description="nodes")
    to: dict[str, Any] | None = Field(default=None, description="a specification in its JSON form")
    components: list[dict[str, Any]] = Field(default_factory=list, description="further component declarations")
    strategy: Literal["minimal", "paper", "quiesce"] = "minimal"

    def request(self) -> Request:
        """The request as the planners know it. Raises SpecificationError for faults inside its documents."""
        return Request.from_document(self.model_dump())


class Change(Incoming):
    """A request to be carried out.

    `expected`: only if the configuration is still of that revision (else it is refused). `verify`: only if Alloy finds
    every step of the plan safe, and what is live after each of them. `id`: any text; the events `waiting` and `command`
    of this change bear it, and what follows until the next `command` belongs to it.
    """

    request: ChangeRequest
    expected: int | None = None
    verify: bool = False
    id: str | None = Field(default=None, max_length=100)


class Error(Outgoing):
    kind: str = Field(description="the name of the exception, as in midstride.errors")
    message: str


class Failure(Outgoing):
    error: Error


class Service(Outgoing):
    """Who answers."""

    system: str
    backend: str
    version: str
    pid: int
    phase: Literal["starting", "up", "failed", "down"]


class Status(Outgoing):
    system: str
    backend: str
    revision: int
    valid: bool
    violations: list[Any]
    running: dict[str, Any] | None
    components: list[dict[str, Any]]
    topics: list[Any]


class Live(Outgoing):
    """The configuration by its components' own word; `silent` did not answer: of these the manager's word is taken."""

    revision: int
    silent: list[str]
    configuration: dict[str, Any]


class Plan(Outgoing):
    """A plan (interfaces.md, JSON), and the configuration's revision that it was made for."""

    strategy: str
    steps: list[dict[str, Any]]
    disruption: float
    fallen: list[str]
    revision: int


class Outcome(Outgoing):
    outcome: Literal["done", "refused", "rolled_back", "failed"]
    seconds: float | None = None
    fallen: dict[str, float] | None = None
    swaps: list[dict[str, Any]] = Field(default_factory=list)
    because: str | None = None
    ended: list[str] = Field(default_factory=list, description="instances that ended by themselves meanwhile")
    degraded: list[str] = Field(
        default_factory=list, description="functionalities that went to a lower mode by themselves meanwhile"
    )
    verdict: dict[str, Any] | None = Field(default=None, description="what Alloy found, where it was asked")


class Why(Outgoing):
    functionality: str
    mode: str
    because: str | None
    chain: list[Any]


class Event(Outgoing):
    n: int
    at: float
    kind: str
    words: str
