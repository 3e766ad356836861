"""What an author has declared of a component: its ports, functionalities, parameters and callbacks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from midstride.node.functionality import Functionality
from midstride.node.parameters import Parameter
from midstride.node.ports import Input, Output


@dataclass(slots=True)
class Callbacks:
    """The author's functions that are called besides those of modes."""

    setup: Callable[[Any], None] | None = None
    stop: Callable[[], Any] | None = None
    stop_timeout: float = 2.0
    export_state: Callable[[], bytes] | None = None
    import_state: Callable[[bytes], None] | None = None


@dataclass(frozen=True, slots=True)
class DeclaredParts:
    """By name, in order of declaration. Complete once the component starts."""

    inputs: dict[str, Input] = field(default_factory=dict)
    outputs: dict[str, Output] = field(default_factory=dict)
    functionalities: dict[str, Functionality] = field(default_factory=dict)
    parameters: dict[str, Parameter] = field(default_factory=dict)
    callbacks: Callbacks = field(default_factory=Callbacks)
