"""The command line at design time, on files in the Stride language: check, fmt, explain, graph, impact, diff, plan."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.plan.test_impact import SHARED

SEEDS = Path(__file__).parents[1] / "lang" / "seeds"


@pytest.fixture
def patrol(tmp_path: Path) -> Path:
    for name in ("patrol.stride", "sensors.stride"):
        shutil.copy(SEEDS / name, tmp_path)
    return tmp_path / "patrol.stride"


def changed(patrol: Path, old: str, new: str, name: str = "new.stride") -> Path:
    text = patrol.read_text(encoding="utf-8")
    assert old in text
    path = patrol.parent / name
    path.write_text(text.replace(old, new), encoding="utf-8")
    return path


def test_the_impact_of_a_container_is_that_of_its_nodes(run: Any, tmp_path: Path) -> None:
    file = tmp_path / "shared.stride"
    file.write_text(SHARED, encoding="utf-8")
    status, out, err = run("impact", file)
    assert (status, err) == (0, "")
    assert "single point of failure: box (component_container): loss 2\n  a crash ends a and b\n  hears_a.hear" in out
    assert "single point of failure: a (Talker): loss 1\n  if it crashes, b ends as well: see box\n" in out


# -- check -------------------------------------------------------------------------------------------------------


def test_a_valid_specification_has_no_problems(run: Any, patrol: Path) -> None:
    assert run("check", patrol) == (0, f"{patrol}: no problems found\n", "")
    assert json.loads(run("check", patrol, "--json")[1]) == {"ok": True, "diagnostics": []}


def test_errors_are_shown_at_their_place(run: Any, patrol: Path) -> None:
    file = changed(patrol, "obstacles <- /obstacles", "obstacles <- /obstacle")
    status, out, err = run("check", file)
    assert (status, err) == (1, "")
    assert "error[E008]: there is no topic `/obstacle`\n" in out
    assert "   help: did you mean `/obstacles`?".strip() in out
    assert out.endswith("\n1 error\n")
    document = json.loads(run("check", file, "--json")[1])
    assert document["ok"] is False
    (fault,) = document["diagnostics"]
    line = file.read_text(encoding="utf-8").split("\n")[fault["line"] - 1]
    assert line[fault["column"] - 1 :].startswith("/obstacle ")


def test_warnings_count_with_strict_only(run: Any, patrol: Path) -> None:
    file = changed(patrol, 'include "sensors.stride"\n', "")
    status, out, _ = run("check", file)
    assert status == 0
    assert "controller.control cannot start in mode normal" in out
    assert "no publisher satisfies /obstacles" in out
    assert run("check", "--strict", file)[0] == 1


def test_an_error_in_a_shared_file_is_reported_once(run: Any, patrol: Path) -> None:
    changed(patrol.parent / "sensors.stride", "out : Scan", "out : Scam", "sensors.stride")
    other = patrol.parent / "other.stride"
    shutil.copy(patrol, other)
    assert run("check", patrol, other)[1].count("there is no contract `Scam`") == 1


def test_types_and_fields_are_checked_unless_disabled(run: Any, tmp_path: Path) -> None:
    file = tmp_path / "s.stride"
    file.write_text("system s\ncontract K = sensor_msgs/msg/Imag\n")
    assert "did you mean `Image`?" in run("check", file)[1]
    assert run("check", "--no-types", file)[0] == 0


@pytest.mark.parametrize("content", [b"\xff\xfe", b"system s\0", b"", b"[" * 100_000])
def test_files_that_are_not_specifications_are_refused(run: Any, tmp_path: Path, content: bytes) -> None:
    for name in ("s.stride", "s.json"):
        file = tmp_path / name
        file.write_bytes(content)
        for command in (["check"], ["fmt"], ["plan", "--remove", "x"], ["graph"], ["impact"], ["export"]):
            status, out, err = run(command[0], file, *command[1:])
            expected = 1
            if command == ["fmt"]:  # which takes no JSON, and has nothing to say of an empty file
                expected = 2 if name == "s.json" else int(content != b"")
            assert status == expected, (command, content[:5])
            assert "Traceback" not in out + err


# -- fmt, explain ------------------------------------------------------------------------------------------------


def test_fmt_rewrites_in_place_once(run: Any, patrol: Path) -> None:
    before = patrol.read_bytes()
    patrol.write_bytes(before.replace(b"{ publishers <= 1 }", b"{publishers<=1}").replace(b"\n", b"\r\n"))
    os.chmod(patrol, 0o640)
    status, out, _ = run("fmt", "--check", patrol)
    assert (status, out) == (1, f"{patrol}: not formatted\n")
    assert run("fmt", patrol) == (0, f"{patrol}: formatted\n", "")
    assert patrol.read_bytes() == before
    assert patrol.stat().st_mode & 0o777 == 0o640
    assert run("fmt", patrol) == (0, "", "")
    assert run("fmt", "--check", patrol) == (0, "", "")
    assert sorted(os.listdir(patrol.parent)) == ["patrol.stride", "sensors.stride"]


def test_fmt_leaves_a_file_with_errors_alone(run: Any, tmp_path: Path) -> None:
    file = tmp_path / "s.stride"
    file.write_text("system   s\ntopic\n")
    status, out, _ = run("fmt", file)
    assert (status, "error[E120]" in out) == (1, True)
    assert file.read_text() == "system   s\ntopic\n"


def test_fmt_goes_through_links(run: Any, tmp_path: Path) -> None:
    (tmp_path / "real.stride").write_text("system   s\n")
    (tmp_path / "link.stride").symlink_to("real.stride")
    assert run("fmt", tmp_path / "link.stride")[0] == 0
    assert (tmp_path / "link.stride").is_symlink()
    assert (tmp_path / "real.stride").read_text() == "system s\n"


def test_explain(run: Any) -> None:
    status, out, _ = run("explain", "e012")
    assert (status, out.split("\n")[0]) == (0, "error E012: M3: the modes disagree on the endpoint of an output")
    assert json.loads(run("explain", "W033", "--json")[1])["severity"] == "warning"
    status, _, err = run("explain", "E0012")
    assert (status, "did you mean `E001`" in err) == (2, True)


# -- graph, impact, diff -------------------------------------------------------------------------------------------


def test_graph_reports_a_missing_graphviz(run: Any, patrol: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run("graph", patrol)[1].startswith('digraph "patrol" {')
    target = patrol.parent / "x.mmd"
    assert run("graph", patrol, "-o", target)[0] == 0
    assert target.read_text().startswith("flowchart LR")
    assert run("graph", patrol, "-o", patrol.parent / "x.pdf")[0] == 2
    monkeypatch.setenv("PATH", str(patrol.parent))
    status, _, err = run("graph", patrol, "-o", patrol.parent / "x.svg")
    assert (status, "need Graphviz" in err) == (1, True)


@pytest.mark.graphviz
@pytest.mark.parametrize(("kind", "magic"), [("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_graph_draws(run: Any, patrol: Path, kind: str, magic: bytes) -> None:
    target = patrol.parent / f"x.{kind}"
    assert run("graph", patrol, "--annotate", "-o", target)[0] == 0
    assert target.read_bytes().startswith(magic)


def test_impact(run: Any, patrol: Path) -> None:
    out = run("impact", patrol)[1]
    assert out.startswith("single point of failure: lidar (Lidar): loss 16\n")
    document = json.loads(run("impact", patrol, "detector", "--json")[1])
    assert [entry["node"] for entry in document["impacts"]] == ["detector"]
    assert document["impacts"][0]["impacted"][0]["to"] == "stop"
    assert run("impact", patrol, "lidr")[0] == 1


def test_the_impact_of_a_node_without_ports_is_not_known(run: Any, tmp_path: Path) -> None:
    file = tmp_path / "robot.stride"
    plain = 'component Plain { run "true" gate preload }\ncomponent Ends { run "true" once }\n'
    file.write_text(f"system robot\n{plain}node arm : Plain\nnode ends : Ends\nnode base : Plain\n")
    listed = ["arm (Plain): not known: no ports are stated", "base (Plain): not known: no ports are stated"]
    assert run("impact", file)[1].splitlines() == [
        listed[0],
        listed[1],
        "ends (Ends): nothing else degrades",
        "Not known: what arm and base rely on: no ports are stated.",
    ]
    assert run("impact", file, "arm")[1].splitlines()[0] == listed[0]


def test_diff(run: Any, patrol: Path) -> None:
    assert run("diff", patrol, patrol) == (0, "No differences.\n", "")
    file = changed(patrol, "threshold = 0.4", "threshold = 0.5")
    status, out, _ = run("diff", patrol, file)
    assert status == 1
    assert "node detector: set\n  parameter threshold: 0.4 -> 0.5, set in place\n" in out


# -- plan --to ---------------------------------------------------------------------------------------------------


def steps(run: Any, *words: object) -> list[str]:
    status, out, _ = run("plan", *words, "--json")
    assert status == 0, out
    return [step["action"] for step in json.loads(out)["steps"]]


def test_a_changeable_parameter_is_set_in_place(run: Any, patrol: Path) -> None:
    assert steps(run, patrol, "--to", changed(patrol, "threshold = 0.4", "threshold = 0.5")) == ["set"]


def test_another_parameter_replaces_the_node(run: Any, patrol: Path) -> None:
    text = patrol.read_text(encoding="utf-8")
    patrol.write_text(text.replace("keep  controller.control at normal", "#"), encoding="utf-8")
    actions = steps(run, patrol, "--to", changed(patrol, "small.onnx", "big.onnx"))
    assert {"create", "remove"} <= set(actions)
    assert "set" not in actions


def test_a_topic_with_another_contract_is_another_topic(run: Any, patrol: Path) -> None:
    text = patrol.read_text(encoding="utf-8")
    patrol.write_text(text.replace("keep  controller.control at normal", "#"), encoding="utf-8")
    file = changed(patrol, ": geometry_msgs/msg/Twist @ 10 Hz {", ": geometry_msgs/msg/Twist {")
    actions = steps(run, patrol, "--to", file)
    assert {"attach", "detach"} <= set(actions)
    assert not {"create", "remove"} & set(actions)


def test_nodes_come_and_go_and_are_rewired(run: Any, patrol: Path) -> None:
    more = "topic /more : Scan\nnode second : Lidar { out -> /more }\n"
    file = changed(
        patrol,
        "node detector   : ObstacleDetector { scan <- /scan",
        more + "node detector : ObstacleDetector { scan <- /more",
    )
    actions = steps(run, patrol, "--to", file)
    assert actions.count("create") == 1
    assert {"attach", "detach", "upgrade"} <= set(actions)
    assert "remove" not in actions
    assert "remove" in steps(run, file, "--to", patrol)
