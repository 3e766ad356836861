"""Statuses as the manager sends them, from what a test states of them."""

from __future__ import annotations

from typing import Any

import msgspec

from midstride.codec.form import encode
from midstride.runtime.records.status_forms import Status
from midstride.verdicts.conditions import system_condition

Document = dict[str, Any]


def status(*components: Document, **changed: Any) -> Status:
    """The status of a valid system with these components, on a simulator."""
    document = {"system": "s", "backend": "sim", "revision": 0, "valid": True, "violations": [], "silences": []}
    document |= {"instances": list(components), "crashed": [], "topics": [], "running": None}
    document |= {
        "unwritten": None,
        "damaged": None,
        "file": None,
        "changed_since": False,
        "middleware": {"name": "sim"},
    }
    document |= {"spares": {"kept": 0, "ready": 0, "unused_by": []}}
    nodes = len(components)
    document["condition"] = encode(system_condition(nodes, nodes, [] if changed.get("valid", True) else ["a fault"]))
    return msgspec.convert(document | changed, Status)


def component(name: str, **changed: Any) -> Document:
    """A component of a status, which responds and has no functionalities."""
    document = {"name": name, "role": name, "component": name.capitalize(), "pid": 7, "node": f"/{name}"}
    document |= {"answers": True, "reachable": True, "ending": False, "waiting": None, "differences": []}
    document |= {"as_modelled": True, "changed_files": [], "unknown_files": None}
    document |= {"namespace": "/", "host": None, "undeclared": [], "deviation": None, "simulated_time": False}
    document |= {"run": None, "log_file": None, "parameters": [], "endpoints": []}
    return document | {"functionalities": [], "ports": []} | changed


def functionality(name: str, mode: str = "normal", **changed: Any) -> Document:
    """A functionality of a component, in its normal mode."""
    document = {"name": name, "mode": mode, "modes": [mode], "modelled": mode, "normal": True}
    return document | {"because": None, "reflex": False, "restoring": None, "since": 1.0, "busy": None} | changed


def crash(name: str, status: int | None = -9, **changed: Any) -> Document:
    """An instance of a status that exited unexpectedly."""
    words = f"{name} exited unexpectedly{'' if status is None else f' (status {status})'}"
    return {"name": name, "status": status, "log": "", "words": words} | changed
