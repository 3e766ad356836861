"""What `up` and changes say of what is degraded afterwards, and the exit status that scripts see."""

from __future__ import annotations

import json
import os
import signal
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

from midstride.cli import main
from midstride.cli.client import Client
from midstride.cli.commands import up
from midstride.cli.input_files import load
from midstride.codec.form import encode
from midstride.runtime.records.reports import UpReport
from midstride.verdicts.conditions import system_condition
from tests.cli.conftest import EXAMPLES, Midstride
from tests.planting import plant
from tests.runtime.systems import rewritten

RAISING = """calls = []


def normal() -> None:
    calls.append(1)
    if len(calls) >= 3:
        raise ValueError("no voice")
"""


def raising(folder: Path, program: str) -> str:
    """The talker's example, in which the function `normal` of one program raises in its third call."""
    written = rewritten(
        "talker",
        folder,
        lambda name, text: text.replace("def normal() -> None:\n", RAISING) if name == program else text,
    )
    return str(written / "talker.stride")


def test_a_node_that_raises_right_after_up_is_named_with_exit_status_3(midstride: Midstride, tmp_path: Path) -> None:
    up = midstride("up", raising(tmp_path / "programs", "talker.py"), "--backend", "sim", "-d")
    assert up.status == 3
    lower = "is in mode degraded instead of normal"
    assert up.out.splitlines()[-3:] == [
        "talker is up (listener, talker).",
        f"Degraded: listener.listen {lower}: talker.talk entered mode degraded unexpectedly.",
        f"Degraded: talker.talk {lower}: mode normal raised: ValueError: no voice.",
    ]
    root = "next: talker.talk: fix the cause, then `midstride restart talker` restores it"
    assert midstride("why", "listener.listen").out.splitlines()[-1] == f"  {root}"
    status = midstride("status")
    assert f"specification: {tmp_path / 'programs' / 'talker.stride'}" in status.out.splitlines()


def test_a_fault_ends_the_wait_for_all_to_stay_up(midstride: Midstride, tmp_path: Path) -> None:
    file = raising(tmp_path / "programs", "talker.py")
    program = Path(file).with_name("talker.py")
    program.write_text(program.read_text().replace(">= 3", ">= 15"))
    assert midstride("up", file, "--backend", "sim", "-d").status == 0
    assert midstride("status", "--for", "0.1").status == 0
    begun = time.monotonic()
    found = midstride("status", "--for", "60", "--json")
    assert found.status == 3 and time.monotonic() - begun < 30
    assert "talker.talk is in mode degraded" in found.json["condition"]["faults"]


@pytest.mark.full
def test_a_manager_that_ends_ends_the_wait_for_all_to_stay_up(talker: Midstride) -> None:
    waiting = talker.start("status", "--for", "60")
    time.sleep(1)  # while it waits; where it has not begun to, it finds no manager
    os.kill(talker.manager("talker"), signal.SIGKILL)
    out, _ = waiting.communicate(timeout=30)
    assert waiting.returncode == 1 and "manager of talker" in out
    assert talker("up", str(EXAMPLES / "talker" / "talker.stride"), "--backend", "sim", "-d").status in (0, 3)


SLOW = """calls = []


def normal() -> None:
    calls.append(1)
    if len(calls) % 3:
        return
"""


def test_an_output_that_does_not_keep_its_rate_is_named_by_up_and_status_with_exit_status_3(
    midstride: Midstride, tmp_path: Path
) -> None:
    written = rewritten(
        "talker",
        tmp_path / "programs",
        lambda name, text: text.replace("def normal() -> None:\n", SLOW) if name == "talker.py" else text,
    )
    up = midstride("up", str(written / "talker.stride"), "--backend", "sim", "-d")
    said = up.out.splitlines()[-1]
    assert (up.status, said[:47]) == (3, "Degraded, all 2 nodes run: talker.out writes 3."), up.out
    assert said.endswith(" Hz, and guarantees 10 Hz.")
    status = midstride("status", "--json")
    assert (status.status, status.json["condition"]["state"], status.json["valid"]) == (3, "degraded", True)


def test_a_node_that_raises_right_after_a_change_is_named_with_exit_status_1(
    midstride: Midstride, tmp_path: Path
) -> None:
    file = raising(tmp_path / "programs", "new_talker.py")
    assert midstride("up", file, "--backend", "sim", "-d").status == 0
    added = midstride("add", "loud", "NewTalker", "out=/chatter", "--yes")
    assert added.status == 1
    afterwards = "loud.talk is in mode degraded instead of normal"
    assert f"Afterwards: {afterwards}: mode normal raised: ValueError: no voice." in added.out.splitlines()
    assert "Nothing fell" not in added.out
    # A loss that the plan has shown is no surprise.
    removed = midstride("remove", "talker", "loud", "--yes")
    assert removed.status == 0
    lowered = "listener.listen is in mode degraded instead of normal"
    assert removed.out.splitlines().count(f"Afterwards: {lowered}.") == 2, "before and after"
    assert f"(proved minimal), and afterwards {lowered};" in removed.out


def test_up_that_cannot_start_a_node_says_which_why_and_what_to_do(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its manager stays: tests/runtime/test_up_again.py."""
    missing = {"talker": "create talker (Talker): talker exited with status 1 before it registered:\nno device"}
    lowered = {"functionality": "talker.talk", "from": "normal", "to": None, "planned": False, "because": "no device"}
    report = {
        "outcome": "incomplete",
        "instances": ["listener"],
        "degraded": [lowered],
        "missing": missing,
        "half_done": [],
    }
    file = EXAMPLES / "talker" / "talker.stride"
    plant(monkeypatch, up, "bring_up", lambda *_, **__: msgspec.convert(report, UpReport))
    condition = system_condition(2, 1, ["talker could not be started"])
    status = SimpleNamespace(condition=condition)
    plant(monkeypatch, up, "await_rates", lambda *_, **__: (status, []))
    plant(monkeypatch, Client, "specification", lambda *_, **__: load(file))
    plant(monkeypatch, Client, "service", lambda *_, **__: None)
    with tempfile.TemporaryDirectory(prefix="ms") as folder:  # a short name: sockets are in it
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        assert main(["up", str(file), "--backend", "sim", "--detach"]) == 3
        assert capsys.readouterr().out.splitlines() == [
            "talker is up without talker (listener).",
            "Degraded: no instance serves talker.talk.",
            f"Missing: talker: {missing['talker'].splitlines()[0]}",
            "no device",
            "Fix the cause, then `midstride restart talker`. The others keep running meanwhile.",
        ]
        assert main(["up", str(file), "--backend", "sim", "--detach", "--json"]) == 3
        assert json.loads(capsys.readouterr().out) == {**report, "condition": encode(condition)}


def test_without_a_terminal_up_prints_each_step_once(midstride: Midstride) -> None:
    up = midstride.start("up", str(EXAMPLES / "talker" / "talker.stride"), "--backend", "sim")
    assert up.stdout is not None
    lines: list[str] = []
    while not lines or not lines[-1].startswith("talker is up"):
        lines.append(up.stdout.readline())
        assert lines[-1], "".join(lines)
    assert midstride("down").status == 0
    rest, _ = up.communicate(timeout=30)
    printed = "".join(lines) + rest
    assert printed.count("create listener (Listener)") == printed.count("upgrade listener.listen") == 1
    assert printed.splitlines()[-1] == "talker is down."


@pytest.mark.parametrize("command", ["check", "up"])
def test_a_program_that_is_not_there_is_warned_of_before_and_named_at_the_start(
    command: str, midstride: Midstride, tmp_path: Path
) -> None:
    """Both processes start at once: the message is about the one that could not."""
    folder = rewritten(
        "talker", tmp_path / "programs", lambda _, text: text.replace("python3 talker.py", "./nosuch --x")
    )
    options = {"check": [], "up": ["--backend", "sim", "-d"]}[command]
    done = midstride(command, str(folder / "talker.stride"), *options)
    if command == "check":
        assert done.status == 0
        assert "component Talker runs `./nosuch --x`, but there is no file" in done.out
    else:
        assert done.status == 3
        assert "✗ 2/6 create talker (Talker)" in done.out
        assert done.out.splitlines()[-2:] == [
            "Missing: talker: the simulator runs `python3 FILE.py` and `python3 -m MODULE`, not `./nosuch --x`",
            "Fix the cause, then `midstride restart talker`. The others keep running meanwhile.",
        ]
        assert midstride("down").status == 0
        strict = midstride(command, str(folder / "talker.stride"), *options, "--strict")
        assert (strict.status, strict.err.startswith("midstride up: create talker (Talker): ")) == (1, True)
