"""``verify``, and ``--verify`` on a running system, as users call them."""

from __future__ import annotations

import json
import os
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from midstride.plan.forms.plan_forms import encode_plan
from tests.cli.conftest import EXAMPLES, Midstride, nothing_lost
from tests.verify.systems import ROVER, TALKER, plan, specification


@pytest.fixture
def spoilt(tmp_path: Path) -> Path:
    """A plan of the talker without its first step."""
    document = encode_plan(plan(specification(TALKER), talker="NewTalker"))
    document["steps"].pop(0)
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


@pytest.mark.alloy
def test_a_plan_from_standard_input(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    status, text, _ = run("plan", TALKER, "--replace", "talker=NewTalker", "--json")
    assert status == 0
    monkeypatch.setattr("sys.stdin", StringIO(text))
    status, out, err = run("verify", TALKER, "--plan", "-")
    assert (status, err) == (0, "")
    assert out.startswith("HOLDS: the plan of 4 steps (exact: 5 configurations, 28 atoms; Alloy 6.2.0)\nVerified in ")


@pytest.mark.alloy
def test_a_violation_is_explained_saved_and_drawn(run: Any, spoilt: Path, tmp_path: Path) -> None:
    kept, drawn = tmp_path / "plan.als", tmp_path / "plan.mmd"
    status, out, _ = run("verify", TALKER, "--plan", spoilt, "-o", kept, "--picture", drawn, "--json")
    document = json.loads(out)
    assert (status, document["verdict"], document["failed"]) == (1, "violated", 1)
    (finding,) = document["findings"]
    assert finding["where"] == "step 1, detach talker.out from /chatter"
    assert (finding["subject"], finding["assumption"]) == ("listener.listen in mode normal", "in")
    assert finding["chain"]["causes"][0]["causes"][0]["name"] == "listener.in"
    assert "pred step1_may { can_detach[S0, topic_chatter, talker_out] }" in kept.read_text(encoding="utf-8")
    assert "/chatter" in drawn.read_text(encoding="utf-8")


def test_a_plan_of_another_system_is_refused(run: Any, spoilt: Path) -> None:
    status, out, _ = run("verify", ROVER, "--plan", spoilt)
    assert status == 1
    assert "it starts from a specification that differs from rover: topic /chatter: added" in out


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"outcome": "refused", "because": "no"}', "PLAN has no plan; it was refused: no"),
        ("[]", "PLAN is not a plan; `midstride plan … --json` prints one"),
        ('{"strategies": {}}', "PLAN compares several plans; `midstride plan … --json` without --compare prints one"),
        ("{}", "/: a plan needs the key `start`"),
        ("{", "not JSON: Expecting property name"),
    ],
)
def test_documents_that_are_not_plans(text: str, words: str, run: Any, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    path.write_text(text, encoding="utf-8")
    status, out, err = run("verify", TALKER, "--plan", path)
    assert (status, out) == (1, "")
    assert words.replace("PLAN", str(path)) in err


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ((), "nothing to verify: pass FILE"),
        ((TALKER, "--live"), "--live cannot be combined"),
        ((TALKER, "--system", "talker"), "--system needs --live"),
        ((TALKER, "--picture", "x.txt"), "unknown kind of diagram"),
        ((TALKER, "--limit", "0"), "--limit"),
    ],
)
def test_wrong_usage(line: tuple[object, ...], words: str, run: Any) -> None:
    status, out, err = run("verify", *line)
    assert (status, out) == (2, "")
    assert words in err


def test_live_without_a_running_system(midstride: Midstride) -> None:
    done = midstride("verify", "--live")
    assert done.status == 1
    assert "no system is running" in done.err


@pytest.mark.alloy
@pytest.mark.ros2
@pytest.mark.full
def test_a_running_system_is_verified_and_changed_only_if_alloy_agrees(midstride: Midstride) -> None:
    """On the simulator, `docs/how-to/verify.md` does so."""
    up = midstride("up", str(EXAMPLES / "talker" / "talker.stride"), "-d", "--backend", "ros2")
    assert up.status == 0, up.err
    live = midstride("verify", "--live")
    assert live.status == 0, live.out + live.err
    assert live.out.startswith("HOLDS: talker as it is running (exact: 1 configuration, 14 atoms; Alloy 6.2.0)")
    done = midstride("replace", "talker", "NewTalker", "--yes", "--verify", "--json")
    assert done.status == 0, done.out + done.err
    assert (done.json["outcome"], done.json["verdict"]["verdict"]) == ("done", "holds")
    assert nothing_lost(done.json["swaps"], "ros2"), done.json["swaps"]
    verdicts = [event["words"] for event in midstride("log", "--json").json if event["kind"] == "verified"]
    assert verdicts == ["HOLDS: the plan of 4 steps (exact: 5 configurations, 28 atoms; Alloy 6.2.0)"]


def test_without_alloy_a_verified_change_does_not_start(midstride: Midstride) -> None:
    talker = str(EXAMPLES / "talker" / "talker.stride")
    up = midstride("up", talker, "-d", "--backend", "sim", MIDSTRIDE_ALLOY=os.devnull)
    assert up.status == 0, up.err
    done = midstride("replace", "talker", "NewTalker", "--yes", "--verify")
    assert done.status == 1
    assert "Refused, nothing was changed: UNKNOWN: the plan of 4 steps: there is no Alloy Analyzer at" in done.out
    assert [c["component"] for c in midstride("status", "--json").json["instances"]] == ["Listener", "Talker"]
