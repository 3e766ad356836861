"""What a component's process is given in its environment."""

from __future__ import annotations

import sys

import pytest

from midstride.node import process_context
from midstride.node.process_context import find

NAMES = {
    "ENV_INSTANCE": ("instance", "talker_2"),
    "ENV_NAMESPACE": ("namespace", "/front"),
    "ENV_TOKEN": ("token", "secret"),
    "ENV_NODE": ("node", "talker"),
}


def test_what_is_in_the_environment_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["talker.py", "--loud", "twice"])
    for variable, (_, value) in NAMES.items():
        monkeypatch.setenv(getattr(process_context, variable), value)
    found = find()
    assert {name: getattr(found, name) for name, _ in NAMES.values()} == dict(NAMES.values())
    assert found.arguments == ("--loud", "twice")


def test_without_it_a_component_has_no_name_of_an_instance_and_no_token(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in NAMES:
        monkeypatch.setenv(getattr(process_context, variable), "")
    found = find()
    assert (found.instance, found.namespace, found.token, found.node) == (None, "", "", None)
