"""What the components report, held against the manager's model."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from midstride.model.configuration import Configuration
from midstride.runtime.watch.observed_configuration import (
    changed_attachments,
    differs,
    observe,
    own_degradations,
    unsupported_modes,
    with_attachments,
    with_failures,
)
from midstride.wire.state import ComponentState
from tests.model import build
from tests.model.build import work
from tests.runtime.scripted import Bench, bench, reported, talking

OUT, IN = build.port("talker.out"), build.port("listener.in")


def on_bench(folder: Path, body: Callable[[Bench], None], configuration: Configuration | None = None) -> None:
    async def main(b: Bench) -> None:
        await asyncio.sleep(0)
        body(b)

    bench(configuration or talking(), folder, main)


def state(name: str, configuration: Configuration | None = None, **changes: object) -> ComponentState:
    configuration = configuration or talking()
    return reported(configuration.instances[name], configuration, **changes)  # type: ignore[arg-type]


def test_the_model_is_observed_where_all_report_what_it_has(tmp_path: Path) -> None:
    def body(b: Bench) -> None:
        assert observe(b.configuration, b.client.life) == (b.configuration, [])
        assert own_degradations(b.configuration, b.client.life) == {}
        assert with_failures(b.configuration, ["talker", "listener"], b.client.life) == b.configuration

    on_bench(tmp_path, body)


def test_what_has_exited_is_missing_and_what_is_silent_is_as_in_the_model(tmp_path: Path) -> None:
    def body(b: Bench) -> None:
        b.crash("talker")
        b.client.states.pop("listener")
        found, silent = observe(b.configuration, b.client.life)
        assert found == b.configuration.without_instance("talker") and silent == ["listener"]
        assert with_failures(b.configuration, ["talker", "listener"], b.client.life) == found

    on_bench(tmp_path, body)


def test_what_has_degraded_by_itself_is_lower_than_in_the_model(tmp_path: Path) -> None:
    def body(b: Bench) -> None:
        b.client.report(state("listener", modes={"work": "degraded"}))
        fallen = b.configuration.with_modes({work("listener"): 1})
        assert own_degradations(b.configuration, b.client.life) == {work("listener"): 1}
        assert observe(b.configuration, b.client.life) == (fallen, [])
        assert with_failures(b.configuration, ["listener"], b.client.life) == fallen
        assert with_failures(b.configuration, ["talker"], b.client.life) == b.configuration
        assert own_degradations(fallen, b.client.life) == {}, "the model has followed"

    on_bench(tmp_path, body)


def test_an_output_behind_a_closed_gate_is_not_attached() -> None:
    configuration = talking()
    closed = state("talker", gates={"out /chatter": "closed"})
    assert changed_attachments(configuration, closed) == ([(OUT, "/chatter")], [])
    assert differs(configuration, closed) and not differs(configuration, state("talker"))


def test_an_attachment_that_the_model_lacks_is_known_by_its_topic() -> None:
    configuration = talking()
    more = state("talker", gates={"out /other": "open"})
    assert changed_attachments(configuration, more) == ([], [(OUT, "/other")])
    away = configuration.without_attachment(OUT, "/chatter")
    assert changed_attachments(away, state("talker")) == ([], [(OUT, "/chatter")])
    assert with_attachments(away, *changed_attachments(away, state("talker"))) == configuration
    assert with_attachments(configuration, [(OUT, "/chatter")], []) == away


def test_a_better_mode_than_in_the_model_is_kept_only_with_its_support() -> None:
    """A command that was taken back has been carried out late."""
    configuration = talking()
    lower = configuration.with_modes({work("listener"): 1})
    better = state("listener")
    assert unsupported_modes(lower, better) == {}
    alone = lower.without_attachment(IN, "/chatter")
    assert unsupported_modes(alone, better) == {work("listener"): 0}
    assert unsupported_modes(configuration, better) == {}, "the model has it"


def test_what_the_model_does_not_have_is_left_alone() -> None:
    unknown, without = state("listener"), talking().without_instance("listener")
    assert unsupported_modes(without, unknown) == {} and not differs(without, unknown)
