"""A planted mistake is called as the original is, or it is not planted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from tests.planting import plant, plant_value
from tests.simulation.planted import PLANTED, planted


@dataclass
class Door:
    opened: int = 0

    def open(self, width: float, *, slowly: bool = False) -> str:
        return f"{width} {slowly}"

    async def close(self) -> None: ...

    @staticmethod
    def material(kind: str) -> str:
        return kind

    @property
    def state(self) -> str:
        return "closed"


def test_what_is_called_alike_is_planted(monkeypatch: pytest.MonkeyPatch) -> None:
    def wider(self: Door, width: float, *, slowly: bool = False) -> str:
        return f"{2 * width} {slowly}"

    plant(monkeypatch, Door, "open", wider)
    plant(monkeypatch, Door, "material", lambda kind: kind.upper())
    plant(monkeypatch, Door, "state", lambda self: "open")
    assert (Door().open(1.0, slowly=True), Door().material("oak"), Door().state) == ("2.0 True", "OAK", "open")
    plant(monkeypatch, Door, "open", lambda self, *_, **__: "")
    assert Door().open(1.0) == ""


async def _closing(self: Door, slowly: bool) -> None: ...


@pytest.mark.parametrize(
    ("name", "replacement"),
    [
        ("open", lambda self, slowly, *, width=False: ""),
        ("open", lambda self, width: ""),
        ("open", lambda self, width, slowly=False: ""),
        ("open", lambda self, width, *, slowly: ""),
        ("open", lambda self, slowly, *_, **__: ""),
        ("open", lambda *_: ""),
        ("close", lambda self: None),
        ("close", _closing),
        ("material", lambda self, kind: kind),
        ("state", lambda: "open"),
        ("state", lambda self: self.locked),
    ],
)
def test_what_is_not_called_alike_is_refused(
    name: str, replacement: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = vars(Door)[name]
    with pytest.raises(ValueError, match=name):
        plant(monkeypatch, Door, name, replacement)
    assert vars(Door)[name] is before


def test_what_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(AttributeError):
        plant(monkeypatch, Door, "lock", lambda self: None)
    with pytest.raises(ValueError, match="no field locked"):
        plant_value(monkeypatch, Door, "locked", bool)


def test_a_value_stays_whatever_is_assigned(monkeypatch: pytest.MonkeyPatch) -> None:
    plant_value(monkeypatch, Door, "opened", lambda: 7)
    door = Door(opened=1)
    door.opened = 2
    assert door.opened == 7


@pytest.mark.parametrize("name", PLANTED)
def test_what_the_simulation_is_to_find_is_called_as_the_code_of_now(name: str) -> None:
    """The simulation finds each of them: tests/simulation/test_long.py."""
    with planted(name) as words:
        assert words
