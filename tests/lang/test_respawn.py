"""Restart policies in the language and in JSON: what they mean, where they are offered and shown, how they differ."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.lang import format_text, load
from midstride.lang.service import LanguageService
from midstride.model.respawn import RespawnPolicy
from midstride.model.specification import Specification
from midstride.plan.specification_diff import differences

TALKERS = """system s

topic /chatter : std_msgs/msg/String @ 10 Hz
host arm { ssh "robot@arm" }

component Talker {
  run "python3 talker.py"
  output out
  functionality talk {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 10 Hz }
    mode silent { }
  }
}

component Simple like Talker { run "python3 simple.py" }

node talker : Talker { out -> /chatter POLICY }
"""


def written(policy: str, folder: Path) -> Specification:
    for name in ("talker.py", "simple.py"):
        (folder / name).touch()
    path = folder / "s.stride"
    path.write_text(TALKERS.replace("POLICY", policy))
    return load(path).require()


@pytest.mark.parametrize(
    ("text", "policy", "document"),
    [
        ("", None, None),
        ("  respawn", RespawnPolicy(), {}),
        (", respawn, respawn_delay 500 ms", RespawnPolicy(delay=0.5), {"delay_seconds": 0.5}),
        (
            "  respawn_delay 2 s to 1 min  respawn",
            RespawnPolicy(delay=2.0, max_delay=60.0),
            {"delay_seconds": 2, "max_delay_seconds": 60},
        ),
        (
            "  respawn  respawn_max_retries 3 in 2 min  respawn_fallback Simple",
            RespawnPolicy(max_retries=3, window=120.0, fallback="Simple"),
            {"max_retries": 3, "window_seconds": 120, "fallback": "Simple"},
        ),
        (
            "  respawn  respawn_fallback Talker on arm lease 2500 ms",
            RespawnPolicy(fallback="Talker", fallback_host="arm", lease=2.5),
            {"fallback": "Talker", "fallback_host": "arm", "lease_seconds": 2.5},
        ),
        (
            "  respawn  respawn_fallback Simple on arm  respawn_max_retries 1",
            RespawnPolicy(max_retries=1, fallback="Simple", fallback_host="arm"),
            {"max_retries": 1, "fallback": "Simple", "fallback_host": "arm"},
        ),
        ("  respawn  respawn_max_retries 0", RespawnPolicy(max_retries=0), {"max_retries": 0}),
        ("  respawn  respawn_max_retries unlimited", RespawnPolicy(max_retries=None), {"max_retries": None}),
    ],
)
def test_a_policy_in_the_language_and_in_json(
    text: str, policy: RespawnPolicy | None, document: dict[str, object] | None, tmp_path: Path
) -> None:
    specification = written(text, tmp_path)
    assert specification.nodes["talker"].respawn == policy
    encoded = encode_specification(specification)
    assert encoded["nodes"]["talker"].get("respawn") == document
    assert decode_specification(encoded) == specification
    formatted = format_text(TALKERS.replace("POLICY", text))
    assert formatted.text is not None and format_text(formatted.text).text == formatted.text


def test_the_delays_double_from_the_first_one_to_the_longest() -> None:
    def delays(policy: RespawnPolicy) -> list[float]:
        return [policy.delay_before(number) for number in range(1, 9)]

    assert delays(RespawnPolicy()) == [0, 1, 2, 4, 8, 16, 30, 30]
    assert delays(RespawnPolicy(delay=3.0, max_delay=10.0)) == [3, 6, 10, 10, 10, 10, 10, 10]
    assert delays(RespawnPolicy(delay=0.2)) == [0.2, 1, 2, 4, 8, 16, 30, 30]
    assert delays(RespawnPolicy(delay=40.0)) == [40] * 8
    assert delays(RespawnPolicy(delay=0.5, max_delay=0.5)) == [0.5] * 8
    assert RespawnPolicy().delay_before(10**9) == 30


def test_the_editor_offers_and_explains_the_statements(tmp_path: Path) -> None:
    specification = written("  respawn  respawn_fallback Simple", tmp_path)
    path, text = tmp_path / "s.stride", (tmp_path / "s.stride").read_text()
    service = LanguageService()
    service.open(path, text)

    def at(before: str) -> tuple[int, int]:
        lines = text[: text.index(before) + len(before)].split("\n")
        return len(lines), len(lines[-1]) + 1

    offered = {each.word for each in service.complete(path, *at("out -> /chatter "))}
    assert {"respawn", "respawn_delay", "respawn_max_retries", "respawn_fallback", "parameters"} <= offered
    assert {each.word for each in service.complete(path, *at("respawn_fallback "))} == {"Talker", "Simple"}
    shown = service.hover(path, *at("node tal"))
    assert shown is not None and "respawn: after 0 s to 30 s, at most 5 in 60 s, then Simple" in shown
    assert specification.components["Simple"].run == "python3 simple.py"
    renamed = service.rename(path, *at("respawn_fallback Sim"), "Plain")
    assert [span.text for span, _ in renamed] == ["Simple", "Simple"]


def test_a_changed_policy_is_a_difference_that_replaces_nothing(tmp_path: Path) -> None:
    before, after = written("", tmp_path), written("  respawn  respawn_delay 2 s", tmp_path)
    [difference] = differences(before, after)
    assert (difference.subject, difference.kind) == ("node talker", "changed")
    assert difference.details == ("respawn: not stated -> after 2 s to 30 s, at most 5 in 60 s",)
