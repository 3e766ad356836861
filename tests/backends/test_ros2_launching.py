"""What a component's process is started with."""

from __future__ import annotations

import json
import os
import sys
import sysconfig
from pathlib import Path

import pytest

from midstride.backends import processes
from midstride.backends.ros2.dds_profiles import PROFILES, RANGE, TRANSPORTS, DdsSettings, choose
from midstride.backends.ros2.manager import launching
from midstride.errors import StartFailed
from midstride.runtime.backend_protocol import Launch

HERE = Path.cwd()


def command(arguments: list[str], directory: Path, environment: dict[str, str]) -> tuple[str, ...]:
    return processes.command(arguments, directory, environment, lambda: sys.executable)


DEFAULTS = DdsSettings("rmw_fastrtps_cpp")
CHOSEN = choose({RANGE: "LOCALHOST"}, "rmw_fastrtps_cpp", 3)


def environment(launch: Launch, program: str, settings: DdsSettings, base: dict[str, str]) -> dict[str, str]:
    return launching.environment(launch, HERE / "components", program, settings, base)


def launch(**fields: object) -> Launch:
    return Launch("front/camera", "front", ("python3", "camera.py"), "the-token", HERE, **fields)  # type: ignore[arg-type]


@pytest.mark.parametrize("program", ["python", "python3"])
def test_python_is_the_one_that_the_manager_runs_in(program: str) -> None:
    assert command([program, "-m", "camera", "--fast"], HERE, {"PATH": "/nowhere"}) == (
        sys.executable,
        "-m",
        "camera",
        "--fast",
    )


def test_another_program_is_found_on_the_path_or_in_the_folder(tmp_path: Path) -> None:
    program = tmp_path / "bin" / "camera"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\n")
    with pytest.raises(StartFailed, match=r"cannot start `camera -v`: there is no program camera"):
        command(["camera", "-v"], tmp_path, {"PATH": str(program.parent)})
    program.chmod(0o755)
    assert command(["camera", "-v"], tmp_path, {"PATH": str(program.parent)}) == (str(program), "-v")
    assert command(["./bin/camera"], tmp_path, {"PATH": ""}) == (f"{tmp_path}/./bin/camera",)
    assert command([str(program)], HERE, {"PATH": ""}) == (str(program),)
    with pytest.raises(StartFailed, match="no program"):
        command(["./camera"], tmp_path, {"PATH": str(program.parent)})


def test_a_component_is_given_its_identity() -> None:
    given = environment(launch(parameters={"gain": 2.0}), sys.executable, DEFAULTS, {"HOME": "/home/me"})
    start = given.pop("MIDSTRIDE_START")
    assert given == {
        "HOME": "/home/me",
        "MIDSTRIDE_BACKEND": "ros2",
        "MIDSTRIDE_INSTANCE": "front/camera",
        "MIDSTRIDE_NODE": "",
        "MIDSTRIDE_STANDBY": "",
        "MIDSTRIDE_PATIENCE": "60",
        "MIDSTRIDE_NAMESPACE": "front",
        "MIDSTRIDE_TOKEN": "the-token",
        "MIDSTRIDE_CONTROL": str(HERE / "components"),
        "MIDSTRIDE_PARAMETERS": json.dumps({"gain": 2.0}),
        "PYTHONUNBUFFERED": "1",
    }
    values = launch(parameters={"gain": 2.0}, set_parameters={"gain": 3.0})
    found = environment(values, sys.executable, DEFAULTS, {"HOME": "/home/me"})
    assert found.pop("MIDSTRIDE_START") != start, "another for each start"
    assert found == {**given, "MIDSTRIDE_SET_PARAMETERS": json.dumps({"gain": 3.0})}


def test_the_same_interpreter_keeps_its_libraries_and_another_one_finds_its_own() -> None:
    own = os.path.join(sys.prefix, "lib")
    base = {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1", "LD_LIBRARY_PATH": f"{own}:/opt/ros/lib"}
    same = environment(launch(), sys.executable, DEFAULTS, base)
    assert (same["_ROS_WHEELS_BOOTSTRAP_COMPLETE"], same["LD_LIBRARY_PATH"]) == ("1", f"{own}:/opt/ros/lib")
    other = environment(launch(), "/usr/bin/python3", DEFAULTS, base)
    assert "_ROS_WHEELS_BOOTSTRAP_COMPLETE" not in other
    assert other["LD_LIBRARY_PATH"] == "/opt/ros/lib"
    alone = environment(launch(), "/usr/bin/python3", DEFAULTS, {**base, "LD_LIBRARY_PATH": own})
    assert "LD_LIBRARY_PATH" not in alone
    sourced = environment(launch(), "/usr/bin/python3", DEFAULTS, {"LD_LIBRARY_PATH": own})
    assert sourced["LD_LIBRARY_PATH"] == own  # not of the wheels: a distribution's own setting


def test_a_program_that_is_linked_with_the_wheels_gets_their_libraries(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prefix = tmp_path / "venv"
    (prefix / "lib").mkdir(parents=True)
    (prefix / "lib" / "librcl.so").touch()
    monkeypatch.setattr(sys, "prefix", str(prefix))
    wheels = f"{prefix}/lib/python3/site-packages/ros_rcl.libs:{prefix}/lib"
    base = {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1", "LD_LIBRARY_PATH": wheels}
    program = tmp_path / "talker"
    for content, linked in (
        (b"\x7fELF\0\0librcl.so\0libc.so.6\0", True),
        (b"\x7fELF\0\0libc.so.6\0", False),
        (b"#!/bin/sh\nexec env LD_PRELOAD=librcl.so talker\n", False),
    ):
        program.write_bytes(content)
        given = environment(launch(), str(program), DEFAULTS, base)
        assert given.get("LD_LIBRARY_PATH", "").startswith(wheels) == linked
        assert sysconfig.get_config_var("LIBDIR") in given.get("LD_LIBRARY_PATH", "").split(":") or not linked
        assert "_ROS_WHEELS_BOOTSTRAP_COMPLETE" not in given  # a Python that it starts is another one
        assert (
            environment(launch(), str(program), DEFAULTS, {"LD_LIBRARY_PATH": "/opt/ros/lib"})["LD_LIBRARY_PATH"]
            == "/opt/ros/lib"
        )  # sourced: as it is


def test_ros_1_is_taken_off_the_path(tmp_path: Path) -> None:
    (tmp_path / "noetic" / "rospy").mkdir(parents=True)
    base = {"PYTHONPATH": f"{tmp_path}/noetic{os.pathsep}{tmp_path}/humble"}
    assert environment(launch(), sys.executable, DEFAULTS, base)["PYTHONPATH"] == f"{tmp_path}/humble"


def test_the_settings_of_the_middleware_go_along_and_suit_the_interpreter(tmp_path: Path) -> None:
    base = {RANGE: "LOCALHOST"}
    same = environment(launch(), sys.executable, CHOSEN, base)
    assert same["FASTDDS_DEFAULT_PROFILES_FILE"] == str(PROFILES / "fastdds3_localhost.xml")
    assert same[RANGE] == "SYSTEM_DEFAULT"
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "libfastrtps.so").touch()
    other = environment(launch(), str(tmp_path / "bin" / "python3"), CHOSEN, base)
    assert other["FASTRTPS_DEFAULT_PROFILES_FILE"] == str(PROFILES / "fastdds2_localhost.xml")
    assert "FASTDDS_DEFAULT_PROFILES_FILE" not in other
    defaults = environment(launch(), str(tmp_path / "bin" / "python3"), DEFAULTS, base)
    assert defaults[RANGE] == "LOCALHOST"
    assert TRANSPORTS not in defaults


def test_a_prefix_stands_before_the_program_and_is_found(tmp_path: Path) -> None:
    tool = tmp_path / "bin" / "wrap"
    tool.parent.mkdir()
    tool.write_text("#!/bin/sh\n")
    tool.chmod(0o755)
    path = {"PATH": str(tool.parent)}
    given = launch(prefix=("wrap", "-n", "5"))
    assert processes.prefixed(given, ("/opt/camera", "-v"), path) == (str(tool), "-n", "5", "/opt/camera", "-v")
    assert processes.prefixed(launch(), ("/opt/camera",), path) == ("/opt/camera",)
    with pytest.raises(StartFailed, match="there is no program wrap for its prefix `wrap -n 5`"):
        processes.prefixed(given, ("/opt/camera",), {"PATH": "/nowhere"})


def test_a_process_has_the_variables_of_its_component_and_not_those_that_it_unsets() -> None:
    given = launch(environment={"MODE": "a b", "DISPLAY": None, "LANG": "C"})
    base = {"DISPLAY": ":0", "LANG": "de", "HOME": "/home/robot"}
    assert processes.surroundings(given, base) == {"HOME": "/home/robot", "MODE": "a b", "LANG": "C"}
