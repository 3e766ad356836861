"""Systems on several hosts by the command line: shown, planned, compared, and carried out on the simulator."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.conftest import Midstride
from tests.runtime.systems import rewritten


def on_hosts(folder: Path, name: str, host: str = "arm") -> Path:
    """The talker's example with its talker on a host."""

    def rewrite(file: str, text: str) -> str:
        if not file.endswith(".stride"):
            return text
        line = "node talker   : Talker   {"
        assert line in text
        return text.replace(line, f"node talker   : Talker on {host} {{") + "host arm { }\nhost base { }\n"

    return rewritten("talker", folder / name, rewrite) / "talker.stride"


def test_plans_differences_and_drawings_name_the_hosts(midstride: Midstride, tmp_path: Path) -> None:
    arm, base = str(on_hosts(tmp_path, "arm")), str(on_hosts(tmp_path, "base", "base"))
    done = midstride("plan", arm, "--on", "talker=base")
    assert done.status == 0, done.err
    assert "create talker_2 (Talker) on base" in done.out and "talker moves from host arm to host base" in done.out
    plan = midstride("plan", arm, "--to", base, "--json").json
    assert [each["host"] for each in plan["steps"] if each["action"] == "create"] == ["base"]
    wrong = midstride("plan", arm, "--on", "talker=bsae")
    assert wrong.status == 1 and "there is no host `bsae`; did you mean `base`?" in wrong.err
    assert midstride("diff", arm, base).out.splitlines() == [
        "node talker: replaced",
        "  moves from host arm to host base",
    ]
    assert "talker on arm" in midstride("graph", arm).out


def test_a_dry_run_says_on_which_host_a_node_would_be_started(midstride: Midstride, tmp_path: Path) -> None:
    file = str(on_hosts(tmp_path, "arm"))
    shown = midstride("up", file, "--backend", "sim", "--dry-run").out.splitlines()
    assert "   in ~ on arm, with its environment" in shown
    assert "  2  create talker (Talker) on arm" in shown
    done = midstride("replace", "talker")
    assert done.status == 2 and "or the host that it moves to: --on HOST" in done.err


@pytest.mark.ros2
def test_on_ros_2_a_dry_run_names_the_host_likewise(midstride: Midstride, tmp_path: Path) -> None:
    shown = midstride("up", str(on_hosts(tmp_path, "arm")), "--backend", "ros2", "--dry-run").out.splitlines()
    assert "   in ~ on arm, with its environment" in shown


def test_generated_packages_say_where_else_they_are_needed(midstride: Midstride, tmp_path: Path) -> None:
    file = str(on_hosts(tmp_path, "arm"))
    done = midstride("generate", file, "--output", str(tmp_path / "made"))
    assert done.status == 0, done.err
    words = "talker: on host arm, where this package has to be built as well; launch itself starts nothing there."
    assert words in done.out


@pytest.mark.full
def test_a_running_system_moves_a_node_and_says_where_it_is(midstride: Midstride, tmp_path: Path) -> None:
    file, other = str(on_hosts(tmp_path, "arm")), str(on_hosts(tmp_path, "other", "manager"))
    assert midstride("up", file, "--backend", "sim", "-d").status == 0

    def hosts() -> dict[str, str | None]:
        return {each["role"]: each["host"] for each in midstride("status", "--json").json["instances"]}

    assert hosts() == {"talker": "arm", "listener": None}
    assert " on arm" in midstride("status").out
    assert midstride("why", "talker.talk").out.splitlines()[0] == "talker.talk on arm is in mode normal"
    done = midstride("replace", "talker", "--on", "base", "--yes")
    assert done.status == 0, done.out + done.err
    assert hosts()["talker"] == "base"
    done = midstride("replace", "talker", "NewTalker", "--on", "arm", "--yes")
    assert done.status == 0, done.out + done.err
    assert hosts()["talker"] == "arm"
    assert midstride("apply", other, "--yes").status == 0
    assert hosts() == {"talker": None, "listener": None}
    assert "replace talker with NewTalker on arm" in midstride("history", "--json").out
