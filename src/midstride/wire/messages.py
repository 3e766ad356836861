"""The envelope: a command with the manager's token and the revision it expects, and its reply.

A component refuses a command without the right token, or whose expected revision is not its own;
a command it has seen already (same ``id``) gets the first answer again and changes nothing.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

from midstride.errors import CommandRefused

Document: TypeAlias = dict[str, Any]

# Environment variables through which a component's process learns who it is.
ENV_INSTANCE: Final = "MIDSTRIDE_INSTANCE"
ENV_NAMESPACE: Final = "MIDSTRIDE_NAMESPACE"
ENV_TOKEN: Final = "MIDSTRIDE_TOKEN"
ENV_BACKEND: Final = "MIDSTRIDE_BACKEND"
ENV_PARAMETERS: Final = "MIDSTRIDE_PARAMETERS"


@dataclass(frozen=True, slots=True)
class Command:
    """One thing asked of one component. ``revision`` None: the command reads and changes nothing."""

    op: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    id: str = ""
    token: str = ""
    revision: int | None = None

    def to_json(self) -> str:
        return json.dumps(
            {
                "op": self.op,
                "arguments": dict(self.arguments),
                "id": self.id,
                "token": self.token,
                "revision": self.revision,
            }
        )

    @classmethod
    def from_json(cls, text: str) -> Command:
        """Raises CommandRefused where ``text`` is not a command."""
        try:
            document = json.loads(text)
            return cls(
                op=str(document["op"]),
                arguments=dict(document.get("arguments") or {}),
                id=str(document.get("id") or ""),
                token=str(document.get("token") or ""),
                revision=document.get("revision"),
            )
        except (ValueError, KeyError, TypeError) as error:
            raise CommandRefused(f"not a Midstride command ({type(error).__name__}: {error})") from None


@dataclass(frozen=True, slots=True)
class Reply:
    """What came of a command. ``refused`` is None where it was carried out."""

    revision: int
    result: Mapping[str, Any] = field(default_factory=dict)
    refused: str | None = None

    @property
    def ok(self) -> bool:
        return self.refused is None

    def to_json(self) -> str:
        return json.dumps({"revision": self.revision, "result": dict(self.result), "refused": self.refused})

    @classmethod
    def from_json(cls, text: str) -> Reply:
        document = json.loads(text)
        return cls(int(document["revision"]), dict(document.get("result") or {}), document.get("refused"))


@dataclass(frozen=True, slots=True)
class Announcement:
    """A component that waits for its manager says who it is: repeated until the manager's `welcome`.

    ``start_token`` echoes the token the process was started with (empty: started elsewhere).
    ``declaration`` is the component's document, as its code declares it; ``endpoints`` are the
    endpoints of its node that are neither ports nor ROS's own, as ``{"kind": …, "name": …}``.
    """

    instance: str
    uuid: str
    pid: int
    start_token: str
    declaration: Document
    endpoints: tuple[Document, ...] = ()
    degraded: bool = False

    def to_json(self) -> str:
        return json.dumps(
            {
                "instance": self.instance,
                "uuid": self.uuid,
                "pid": self.pid,
                "start_token": self.start_token,
                "declaration": self.declaration,
                "endpoints": list(self.endpoints),
                "degraded": self.degraded,
            }
        )

    @classmethod
    def from_json(cls, text: str) -> Announcement:
        document = json.loads(text)
        return cls(
            instance=document["instance"],
            uuid=document["uuid"],
            pid=int(document["pid"]),
            start_token=document["start_token"],
            declaration=document["declaration"],
            endpoints=tuple(document.get("endpoints") or ()),
            degraded=bool(document.get("degraded")),
        )
