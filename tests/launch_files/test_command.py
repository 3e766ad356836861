"""`midstride import`: the specification, the findings and the exit status."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from midstride.cli import main

LAUNCH = '<launch>\n  <arg name="who"/>\n  <node pkg="nix" exec="a" name="$(var who)"/>\n</launch>\n'


@pytest.fixture
def launch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "robot.launch.xml"
    file.write_text(LAUNCH)
    return Path(file.name)


def test_the_specification_is_printed_and_the_findings_beside_it(
    launch: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    assert main(["import", str(launch), "who:=me"]) == 0
    printed = capsys.readouterr()
    assert printed.out.endswith("node me : A\n")
    assert printed.err.splitlines() == [
        "robot.launch.xml:3: package: package `nix` is not here",
        "1 node from 1 launch file; 1 finding (1 package)",
        "Packages are looked up in AMENT_PREFIX_PATH, which is not set; source your workspace, or name its sources: "
        "`midstride --include-path DIR import …`",
    ]


def test_an_existing_file_is_kept(launch: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", str(launch), "who:=me", "-o", "robot.stride"]) == 0
    written = Path("robot.stride").read_text()
    assert main(["import", str(launch), "who:=you", "-o", "robot.stride"]) == 1
    assert "robot.stride exists" in capsys.readouterr().err
    assert Path("robot.stride").read_text() == written


def test_json(launch: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", str(launch), "--json"]) == 3
    document = json.loads(capsys.readouterr().out)
    assert document["nodes"] == 0 and document["counts"] == {"argument": 2, "package": 1}
    assert document["left_out"] == {"argument": 2} and document["parameter_files"] == []
    assert document["findings"][0] == {
        "kind": "argument",
        "message": "`who` has no value and no default; pass `who:=…`",
        "file": "robot.launch.xml",
        "line": 2,
        "column": 3,
        "left_out": True,
    }


@pytest.mark.parametrize(("words", "status"), [(["who=me"], 2), ([":=me"], 2)])
def test_wrong_usage(launch: Path, words: list[str], status: int) -> None:
    assert main(["import", str(launch), *words]) == status


def test_what_is_left_out_is_counted_at_the_end_and_gives_an_exit_status(
    launch: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = LAUNCH.replace(
        "</launch>", f'<shutdown/><node exec="./b" name="b"><param name="x-1" value="{"y" * 9000}"/></node></launch>'
    )
    launch.write_text(text)
    assert main(["import", str(launch), "who:=me", "-o", "robot.stride"]) == 3
    assert capsys.readouterr().err.splitlines()[-1] == "Left out: 1 unsupported"
    assert Path("robot.parameters.b.yaml").read_text() == f"/**:\n  ros__parameters:\n    x-1: {'y' * 9000}\n"
    Path("robot.stride").unlink()
    assert main(["import", str(launch), "who:=me", "-o", "robot.stride"]) == 1
    assert "robot.parameters.b.yaml exists" in capsys.readouterr().err and not Path("robot.stride").exists()


def test_commands_are_carried_out_by_an_option(launch: Path, capsys: pytest.CaptureFixture[str]) -> None:
    launch.write_text("""<launch><node exec="./a" name="a" args="$(command 'echo hi')"/></launch>""")
    assert main(["import", str(launch)]) == 3
    assert main(["import", str(launch), "--run-commands"]) == 0
    assert "\"./a 'hi\\n'\"" in capsys.readouterr().out


def test_a_launch_file_is_read_for_the_ros_that_is_asked_for(
    launch: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    launch.write_text('<launch><node pkg="nix" type="a" exec="a" name="n"/></launch>')
    assert main(["import", str(launch), "--ros", "1"]) == 0
    printed = capsys.readouterr()
    assert 'run "rosrun nix a" gate relay' in printed.out
    assert "Packages are looked up in ROS_PACKAGE_PATH, which is not set;" in printed.err
    assert main(["import", str(launch), "--ros", "2"]) == 3
    assert 'run "a" package "nix" gate preload' in capsys.readouterr().out
