"""Launch files of ROS 1 become specifications: what they state is in them, or is reported at its line."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from pathlib import Path

import pytest

from midstride.errors import SpecificationError
from midstride.launch_files.dialects import Ros
from midstride.launch_files.launch_import import Imported, import_launch_file
from tests.launch_files.roslaunched import CATALOGUE, ENVIRONMENT
from tests.launch_files.support import commands, imported, kinds, specification

NODE = '<node pkg="p" type="driver" name="n"/>'
ARM = '<machine name="arm" address="10.77.0.2" user="robot" env-loader="{}" {}/>\n'
ON_ARM = '<node pkg="p" type="driver" name="n" machine="arm"/>'


def of_ros1(
    folder: Path,
    body: str,
    arguments: Mapping[str, str] | None = None,
    environment: Mapping[str, str] | None = None,
) -> Imported:
    """The import of a launch file of ROS 1 with these elements, whose package has one program."""
    package = folder / "src" / "p"
    package.mkdir(parents=True, exist_ok=True)
    (package / "package.xml").write_text("<package><name>p</name></package>")
    (package / "driver").write_text("#!/bin/sh\n")
    (package / "driver").chmod(0o755)
    file = folder / "robot.launch"
    file.write_text(f"<launch>\n{body}\n</launch>\n", encoding="utf-8")
    return imported(file, arguments, ROS_PACKAGE_PATH=str(folder / "src"), **(environment or {}))


def said(found: Imported, kind: str) -> list[str]:
    return [each.message for each in found.findings if each.kind == kind]


def test_a_robot_with_two_computers(tmp_path: Path) -> None:
    found = import_launch_file(
        CATALOGUE / "robot-with-two-computers.launch",
        {},
        ENVIRONMENT,
        tmp_path / "robot.stride",
        run_commands=True,
    )
    assert found.ros == 1 and found.files == 4 and found.nodes == 4
    assert 'host arm { ssh "robot@10.77.0.2"   setup "/opt/ros/noetic/setup.bash" }' in found.text
    assert "namespace robot1/arms {\n  node right_gripper : Gripper on arm {" in found.text
    command = "rosrun made_up_robot driver cmd_vel:=base/cmd_vel odom:=/robot1/odom"
    assert f'run "{command}" prefix "nice -n 5" gate relay' in found.text
    command = "rosrun made_up_robot planner.py --goal 'robot1 home' _tries:=3 map:=/map cmd_vel:=base/cmd_vel"
    assert f'run "{command}" gate relay' in found.text
    system = specification(found, tmp_path)
    assert dict(system.instance("robot1/planner").parameters) == {
        "costmap.global_frame": "map",
        "costmap.width": 7,
        "costmap.resolution": 0.05,
        "costmap.rolling": True,
        "costmap.origin.x": 0.0,
        "costmap.origin.y": -1.5,
        "gains": [1.0, 2.5],
        "patience": 5,
    }
    assert {name: node.host for name, node in system.nodes.items()} == {
        "robot1/base": "",
        "robot1/planner": "",
        "robot1/arms/right_gripper": "arm",
        "robot1/camera": "",
    }
    text = found.parameter_files["robot.rosparam.yaml"]
    assert 'robot_description: <robot name="robot1"/>' in text and "laser: robot1/laser" in text
    assert text.count("type: costmap_2d::StaticLayer") == 2
    assert sorted(said(found, "host")) == [
        "`/opt/ros/noetic/env.sh` is taken for catkin's: `setup` is the file beside it; it may set more on the host",
        "`timeout` of the machine `arm` is left out: Midstride has its own",
        "machines become hosts: plans show them, and `up --backend ros1` refuses hosts besides the manager's",
    ]


# -- which ROS a launch file is for ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "ros"),
    [
        (NODE, 1),
        ('<node exec="a" name="n"/>', 2),
        ("", 2),
        ('<arg name="a" default="1"/>', 2),
        ('<arg name="a" value="1"/>', 1),
        ('<group ns="a"><arg name="a" default="1"/></group>', 1),
        ('<include file="$(find p)/x.launch"/>', 1),
        ('<include file="$(find-pkg-share p)/x.launch"/>', 2),
        ('<include file="x.launch" pass_all_args="true"/>', 1),
        ('<arg name="a" default="$(arg b)"/>', 1),
        (f"<group>{NODE}</group>", 1),
        ('<rosparam command="load" file="x.yaml"/>', 1),
        ('<machine name="a" address="b"/>', 1),
        ('<test test-name="t" pkg="p" type="t"/>', 1),
        ('<remap from="a" to="b"/>', 1),
        ('<let name="a" value="$(arg b)"/>', 2),  # a mistake in ROS 2
        ('<group ns="a"><node exec="a" name="n"/></group>', 2),
    ],
)
def test_what_only_one_dialect_has_decides(tmp_path: Path, body: str, ros: int) -> None:
    file = tmp_path / "a.launch"
    file.write_text(f"<launch>{body}</launch>")
    assert import_launch_file(file, {}, {}, None).ros == ros


def test_a_launch_file_that_mixes_both_is_read_as_it_is_asked_for(tmp_path: Path) -> None:
    file = tmp_path / "a.launch"
    file.write_text(f'<launch>\n{NODE}\n<group>\n<node exec="./b" name="m"/></group></launch>')
    message = (
        r"a\.launch: it mixes ROS 1 \(`type` of `node` in line 2\) and ROS 2 \(`exec` of `node` in line 4\); `--ros"
    )
    with pytest.raises(SpecificationError, match=message):
        import_launch_file(file, {}, {}, None)
    one, two = (import_launch_file(file, {}, {}, None, ros=ros) for ros in (1, 2))
    assert one.nodes == two.nodes == 1 and "node n : Driver" in one.text and "node m : B" in two.text
    assert any("`node` has no `pkg`" in each for each in said(one, "refused"))
    assert any("`node` has no `exec`" in each for each in said(two, "refused"))


def test_an_included_launch_file_is_of_the_same_ros(tmp_path: Path) -> None:
    (tmp_path / "one.launch").write_text(f"<launch>{NODE}</launch>")
    (tmp_path / "two.launch").write_text('<launch><node exec="./b" name="m"/></launch>')
    file = tmp_path / "a.launch"
    for own, other in (("one", "two"), ("two", "one")):
        includes = "".join(f'<include file="$(dirname)/{name}.launch"/>' for name in (own, other))
        file.write_text((tmp_path / f"{own}.launch").read_text().replace("</launch>", f"{includes}</launch>"))
        found = imported(file)
        ros = 1 if own == "one" else 2
        assert found.ros == ros and found.nodes == 2
        [message] = said(found, "include")
        assert message.startswith(
            f"`include` is left out: `{other}.launch`: it is a launch file of ROS {3 - ros}; with"
        )


# -- machines ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("script", "setup", "message"),
    [
        ('#!/bin/bash\n\n# ROS\nsource /opt/ros/noetic/setup.bash\nexec "$@"\n', "/opt/ros/noetic/setup.bash", ""),
        (
            ". '/w/setup.sh'\nexport ROS_IP=10.0.0.1\nexport SECRET=hunter2\nexec $@",
            "/w/setup.sh",
            "`ROS_IP`, `SECRET`",
        ),
        ('. "$_CATKIN_SETUP_DIR/setup.sh"\nexec "$@"\n', "FOLDER/setup.bash", ""),
        ("source /a/setup.bash\nsource /b/setup.bash\nexec $@\n", None, "what `env-loader`"),
        ("source ~/setup.bash\nexec $@\n", None, "what `env-loader`"),
        ("source /a/setup.bash; rm -r /\nexec $@\n", None, "what `env-loader`"),
        ("source /a/$(id)\nexec $@\n", None, "what `env-loader`"),
        ("", None, "what `env-loader`"),
    ],
)
def test_a_script_that_sets_the_environment_becomes_what_it_sources(
    tmp_path: Path, script: str, setup: str | None, message: str
) -> None:
    (tmp_path / "load.sh").write_text(script)
    found = of_ros1(tmp_path, ARM.format(tmp_path / "load.sh", "") + ON_ARM)
    host = specification(found, tmp_path).hosts["arm"]
    assert host.ssh == "robot@10.77.0.2"
    assert host.setup == (None if setup is None else setup.replace("FOLDER", str(tmp_path)))
    left = [each.message for each in found.findings if each.kind == "host" and each.left_out]
    assert [message in each for each in left] == ([True] if message else [])
    assert "hunter2" not in found.text + str(list(found.findings))


@pytest.mark.parametrize(
    ("loader", "environment", "setup", "left_out"),
    [
        ("/opt/ros/noetic/env.sh", {}, "/opt/ros/noetic/setup.bash", False),
        ("/home/robot/loader.bash", {}, None, True),
        ("env.sh", {}, None, True),
        ("/opt/my ros/env.sh", {}, None, True),
        ("", {"ROS_VERSION": "1", "ROS_DISTRO": "noetic"}, "/opt/ros/noetic/setup.bash", False),
        ("", {"ROS_VERSION": "2", "ROS_DISTRO": "jazzy"}, None, True),
        ("", {}, None, True),
    ],
)
def test_a_script_that_is_not_here_is_only_assumed_to_be_catkin_s(
    tmp_path: Path, loader: str, environment: dict[str, str], setup: str | None, left_out: bool
) -> None:
    machine = ARM.format(loader, "") if loader else ARM.format("", "").replace('env-loader=""', "")
    found = of_ros1(tmp_path, machine + ON_ARM, environment=environment)
    assert specification(found, tmp_path).hosts["arm"].setup == setup
    assert [
        each.left_out for each in found.findings if each.kind == "host" and "machines become" not in each.message
    ] == [left_out]


def test_a_password_is_never_carried_over(tmp_path: Path) -> None:
    found = of_ros1(tmp_path, ARM.format("/opt/ros/noetic/env.sh", 'password="hunter2" ssh-port="2222"') + ON_ARM)
    everything = found.text + "".join(str(each.to_json()) for each in found.findings)
    assert "hunter2" not in everything and "2222" not in found.text
    assert "`password` of the machine `arm` is left out: SSH keys replace it" in said(found, "host")
    assert any("the port 2222 of `arm` is left out" in each for each in said(found, "host"))


def test_a_machine_that_is_this_computer_is_the_host_of_the_manager(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("getpass.getuser", lambda: "me")
    own = ("localhost", "127.0.0.1", "127.0.1.1", "::1", socket.gethostname())
    body = "".join(
        f'<machine name="m{n}" address="{address}" user="{user}"/>'
        f'<node pkg="p" type="driver" name="n{n}" machine="m{n}"/>\n'
        for n, (address, user) in enumerate([*((each, "") for each in own), ("localhost", "me"), ("localhost", "you")])
    )
    system = specification(of_ros1(tmp_path, body), tmp_path)
    assert {name: node.host for name, node in system.nodes.items() if node.host} == {"n6": "m6"}
    assert {host.ssh for host in system.hosts.values()} == {"you@localhost"}


def test_only_machines_with_nodes_are_hosts_and_equal_ones_are_one(tmp_path: Path) -> None:
    machines = "".join(f'<machine name="{name}" address="10.77.0.2"/>\n' for name in ("c1", "manager", "other"))
    nodes = "".join(f'<node pkg="p" type="driver" name="{n}" machine="{n}"/>\n' for n in ("manager", "c1"))
    found = of_ros1(tmp_path, machines + nodes)
    assert list(specification(found, tmp_path).hosts) == ["manager_1"]
    assert "the machine `manager` is named `manager_1`" in said(found, "name")


@pytest.mark.parametrize("address", ["-oProxyCommand=x", "a b", "a\u200b", ""])
def test_what_is_no_destination_is_left_out(tmp_path: Path, address: str) -> None:
    found = of_ros1(tmp_path, f'<machine name="arm" address="{address}"/>\n{ON_ARM}')
    assert not specification(found, tmp_path).hosts
    assert any("the machine `arm` is left out" in each for each in said(found, "host"))


# -- parameters --------------------------------------------------------------------------------------------------------


def test_what_the_language_has_not_is_in_a_file_for_rosparam(tmp_path: Path) -> None:
    values = "{good: [1, 2], empty: [], mixed: [1, a], deep: [[1]], none: null, a: {x.y: 1, z: 2}}"
    body = f"""<param name="robot_description" value="&lt;robot/&gt;"/>
      {NODE}<rosparam ns="n">{values}</rosparam>"""
    found = of_ros1(tmp_path, body)
    assert dict(specification(found, tmp_path).instance("n").parameters) == {"good": [1, 2], "a.z": 2}
    assert found.parameter_files == {
        "imported.rosparam.yaml": "n:\n  a:\n    x.y: 1\n  deep:\n  - - 1\n  empty: []\n  mixed:\n  - 1\n  - a\n"
        "  none: null\nrobot_description: <robot/>\n"
    }
    description, others = said(found, "parameters")
    assert description.startswith("left out, of no node or of no type of the language: `/robot_description`;")
    assert "`/n/empty`, `/n/mixed`, `/n/deep`, `/n/none`, …" in others and "`rosparam load imported.rosparam" in others
    without = import_launch_file(tmp_path / "robot.launch", {}, {}, None)
    assert without.parameter_files == {}
    assert all("with `-o FILE`" in each for each in said(without, "parameters"))


def test_text_stays_text_whatever_ros_2_would_read(tmp_path: Path) -> None:
    values = {"a": "1e3", "b": "y", "c": "0x10", "d": "null", "e": "~", "f": "x" * 1200, "g": "two\nlines"}
    listed = "".join(f"{name}: {value!r}\n".replace("'", '"') for name, value in values.items())
    found = of_ros1(tmp_path, f'<node pkg="p" type="driver" name="n"><rosparam>{listed}</rosparam></node>')
    assert dict(specification(found, tmp_path).instance("n").parameters) == values


def test_changes_of_what_is_on_the_server_are_left_out(tmp_path: Path) -> None:
    body = """<rosparam command="delete" param="old"/>
      <rosparam command="dump" file="/tmp/x.yaml"/>
      <node pkg="p" type="driver" name="n" clear_params="true"/>
      <param name="b" binfile="x"/>"""
    found = of_ros1(tmp_path, body)
    assert [(each.kind, each.left_out) for each in found.findings if each.kind == "parameters"] == [
        ("parameters", True),
        ("parameters", True),
        ("parameters", False),
        ("parameters", True),
    ]


def test_a_program_is_not_run_unless_that_is_asked_for(tmp_path: Path) -> None:
    found = of_ros1(tmp_path, f'<param name="p" command="touch {tmp_path}/made"/>')
    assert not (tmp_path / "made").exists() and "`--run-commands` carries it out" in said(found, "command")[0]


# -- nodes -------------------------------------------------------------------------------------------------------------


def test_packages_and_programs_are_looked_up_in_ros_package_path(tmp_path: Path) -> None:
    installed = tmp_path / "install" / "lib" / "q" / "cpp_driver"
    installed.parent.mkdir(parents=True)
    installed.write_text("#!/bin/sh\n")
    installed.chmod(0o755)
    (tmp_path / "src" / "q").mkdir(parents=True)
    (tmp_path / "src" / "q" / "package.xml").write_text("<package><name>q</name></package>")
    nodes = (("p", "driver"), ("p", "drivr"), ("q", "cpp_driver"), ("gone", "driver"))
    body = "".join(f'<node pkg="{pkg}" type="{kind}" name="{pkg}_{kind}"/>\n' for pkg, kind in nodes)
    found = of_ros1(
        tmp_path,
        f"{body}<param name='x' value='$(find q)/bin/cpp_driver'/>",
        environment={"CMAKE_PREFIX_PATH": str(tmp_path / "install")},
    )
    assert said(found, "package") == [
        f"package `p` has no executable `drivr` in {tmp_path}/src/p; did you mean `driver`?",
        "package `gone` is not here",
    ]
    assert f"x: {installed}\n" in found.parameter_files["imported.rosparam.yaml"]


def test_what_midstride_passes_itself_is_not_passed_twice(tmp_path: Path) -> None:
    body = '<node pkg="p" type="driver" name="n" ns="a" args="x __name:=other __ns:=/b/c _rate:=5 in:=out"/>'
    found = of_ros1(tmp_path, body)
    assert commands(found, tmp_path) == {"b/c/n": "rosrun p driver x _rate:=5 in:=out"}


def test_folders_of_programs(tmp_path: Path) -> None:
    nodes = [
        f'<node pkg="p" type="driver" name="n{n}" {cwd}/>' for n, cwd in enumerate(["", 'cwd="node"', 'cwd="ROS_HOME"'])
    ]
    remote = ARM.format("/opt/ros/noetic/env.sh", "") + ON_ARM.replace("/>", ' cwd="node"/>')
    found = of_ros1(tmp_path, "\n".join([*nodes, remote]), environment={"ROS_HOME": "/var/ros"})
    system = specification(found, tmp_path)
    prefixes = {name: system.components[node.component].prefix for name, node in system.nodes.items()}
    folder = f"env --chdir={tmp_path}/src/p"
    assert prefixes == {"n0": None, "n1": folder, "n2": "env --chdir=/var/ros", "n": None}
    assert "`cwd` of a node is left out: that is a folder of the machine `arm`" in said(found, "host")
    assert [each for each in said(found, "unsupported") if "ROS_HOME" in each] != []


def test_names_that_change_at_each_launch_are_kept(tmp_path: Path) -> None:
    body = '<node pkg="p" type="driver" name="$(anon cam)" args="$(eval anon(\'cam\') + \'x\')"/>'
    found = of_ros1(tmp_path, body)
    assert commands(found, tmp_path) == {"cam": "rosrun p driver camx"}
    assert set(said(found, "name")) == {"`$(anon …)` is another name at each launch, and always the same here"}


def test_a_program_that_is_known_to_end_is_once(tmp_path: Path) -> None:
    nodes = (("gazebo_ros", "spawn_model"), ("controller_manager", "spawner"))
    body = "".join(f'<node pkg="{pkg}" type="{program}" name="{program}"/>' for pkg, program in nodes)
    found = of_ros1(tmp_path, body)
    assert 'run "rosrun gazebo_ros spawn_model" once' in found.text
    assert 'run "rosrun controller_manager spawner" gate relay' in found.text  # in ROS 1, it keeps running


def test_what_roslaunch_passes_over_or_has_no_counterpart_is_said(tmp_path: Path) -> None:
    body = """<node pkg="p" type="driver" name="a" colour="red" required="true"><sub/></node>
<unknown/>
<test test-name="t" pkg="p" type="t"/>
<remap from="a" to="b" if="true" when="x"/>"""
    found = of_ros1(tmp_path, body)
    places = [
        (each.place.rpartition(":")[2], each.left_out) for each in found.findings if "ROS_HOME" not in each.message
    ]
    assert places == [("2", False), ("2", False), ("2", True), ("3", False), ("4", False), ("5", False)]


# -- launch files that are wrong, or a stranger's ----------------------------------------------------------------------


def test_files_outside_the_allowed_folders_are_not_read(tmp_path: Path) -> None:
    robot = tmp_path / "robot"
    robot.mkdir()
    (tmp_path / "secret").write_text("hunter2")
    (robot / "link").symlink_to(tmp_path / "secret")
    body = f"""<param name="a" textfile="{tmp_path}/secret"/>
      <param name="b" textfile="$(dirname)/../secret"/>
      <param name="c" textfile="$(dirname)/link"/>
      <rosparam file="{tmp_path}/secret" param="d"/>
      <include file="/etc/passwd"/>
      {ARM.format(tmp_path / "secret", "")}{ON_ARM}"""
    found = of_ros1(robot, body)
    assert "hunter2" not in found.text + str(found.parameter_files) + str(list(found.findings))
    assert len(said(found, "parameters")) == 4 and len(said(found, "include")) == 1


def test_launch_files_that_include_each_other_end(tmp_path: Path) -> None:
    (tmp_path / "b.launch").write_text(f'<launch>{NODE}<include file="$(dirname)/robot.launch" ns="x"/></launch>')
    found = of_ros1(tmp_path, '<include file="$(dirname)/b.launch" ns="x"/>')
    assert sum("include too many others" in each for each in said(found, "include")) == 1


@pytest.mark.parametrize(
    ("body", "kind", "message"),
    [
        (
            '<node pkg="p" type="driver" name="n" cwd="home"/>',
            "refused",
            "`cwd` is `home`, and can be node or ROS_HOME",
        ),
        ('<node pkg="p" type="driver" name="n" respawn_delay="soon"/>', "refused", "is `soon`, and no number"),
        ('<node pkg=" " type="driver" name="n"/>', "refused", "`pkg`, `type` or `name` of `node` is empty"),
        ('<machine name="m" address="a"><env name="A" value="1"/></machine>', "refused", "`env` in `machine`"),
        ('<machine name="m" address="a" ssh-port="x"/>', "refused", "`ssh-port` is `x`, and no number"),
        ('<group clear_params="true"/>', "refused", "`clear_params` without `ns`"),
        ('<param name="" value="1"/>', "refused", "the name of a `param` is empty"),
        ('<param name="a" value="[" type="yaml"/>', "parameters", "is not valid YAML"),
        ('<param name="a" value="!!timestamp x" type="yaml"/>', "parameters", "it has a value that cannot be read"),
        ('<param name="a" value="$(env)"/>', "substitution", "`$(env)`: wrong number of arguments"),
        ('<rosparam param="~a">1</rosparam>', "parameters", "`~a` would be a private parameter of roslaunch itself"),
        ("<rosparam>{a: rad(x)}</rosparam>", "parameters", "it has a value that cannot be read"),
        ("<rosparam>{a: [1, 2.5]}</rosparam>" + NODE.replace('"n"', '"x"'), "parameters", "left out, of no node"),
        ("<rosparam>{n: {a: [1, 2.5]}}</rosparam>" + NODE, "parameters", "`/n/a` mixes integers and other numbers"),
        ('<arg name="a" default="$(env NO)"/><param name="p" value="$(arg a)"/>', "substitution", "`NO` is not set"),
        (
            '<arg name="a" default="1" if="$(env NO)"/><param name="p" value="$(arg a)"/>',
            "condition",
            "whether `a` is set",
        ),
        ('<arg name="a" default="$(env NO)"/><param name="p" value="$(eval a)"/>', "substitution", "`NO` is not set"),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(tmp_path: Path, body: str, kind: str, message: str) -> None:
    found = of_ros1(tmp_path, body + '<remap from="a" to="b"/>')
    assert [message in each for each in said(found, kind)].count(True) == 1, list(map(str, found.findings))


def test_an_argument_without_a_known_value_is_passed_on_as_such(tmp_path: Path) -> None:
    (tmp_path / "b.launch").write_text(
        '<launch deprecated="use c.launch"><arg name="a"/><arg name="b" default="1"/>'
        '<node pkg="p" type="driver" name="n" args="$(arg b)"/>'
        '<node pkg="p" type="driver" name="m" args="$(arg a)"/></launch>'
    )
    found = of_ros1(
        tmp_path, '<include file="$(find p)/../../b.launch"><arg name="a" value="$(env NO)"/></include>' + NODE
    )
    assert {each.message for each in found.findings if each.kind in {"substitution", "unsupported"}} >= {
        "the launch file is deprecated: use c.launch",
        "`args` of a node is left out: `a` has no known value: the environment variable `NO` is not set",
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<launch>\n<machine>\n</launch>", r"line 3 is not valid XML: mismatched tag"),
        ("<robot><machine/></robot>", r"its outermost element is not `launch`"),
        ("<!DOCTYPE launch [<!ENTITY a 'b'>]><launch><machine/></launch>", r"it has a document type declaration"),
        ("<launch>" + "<group>" * 70 + "</group>" * 70 + "</launch>", r"nested more than 64 deep"),
        ("", r"line 1 is not valid XML: no element found"),
    ],
)
def test_what_is_no_launch_file_is_refused(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "a.launch"
    file.write_text(text)
    choices: tuple[Ros | None, ...] = (None, 1)
    for ros in choices:
        with pytest.raises(SpecificationError, match=message):
            import_launch_file(file, {}, {}, None, ros=ros)


def test_values_without_end_are_refused(tmp_path: Path) -> None:
    laughs = "a0: &amp;a0 {x: 1}\n" + "".join(
        f"a{n}: &amp;a{n} {{{', '.join(f'k{k}: *a{n - 1}' for k in range(9))}}}\n" for n in range(1, 9)
    )
    found = of_ros1(tmp_path, f"{NODE}<rosparam>{laughs}</rosparam><rosparam>&amp;a [*a]</rosparam>")
    assert "it has more than can be read" in said(found, "parameters")[0] and found.nodes == 1
    found = of_ros1(tmp_path, f"<param name='a' value=\"$(eval 'x' * 10 ** 9)\"/>{NODE}")
    assert found.nodes == 1 and len(said(found, "substitution")) == 1


def test_names_that_are_too_long_are_cut_or_left_out(tmp_path: Path) -> None:
    name = "x" * 300
    found = of_ros1(
        tmp_path,
        f"""<machine name="{name}" address="10.77.0.2"/>
        <node pkg="p" type="{name}" name="{name}" machine="{name}"><param name="{name}" value="1"/></node>
        <node pkg="p" type="driver" name="n" ns="{name}"/>""",
    )
    [node] = specification(found, tmp_path).nodes.values()
    assert node.role == "x" * 200 == node.host and node.component == f"X{'x' * 199}"
    assert any(each.endswith("is not a namespace") for each in said(found, "name"))


def test_the_namespace_and_arguments_of_the_command(tmp_path: Path) -> None:
    body = '<arg name="a" default="1"/><node pkg="p" type="driver" name="n" args="$(arg a)"/>'
    found = of_ros1(tmp_path, body, {"a": "2", "__ns": "/fleet", "b": "3"})
    assert commands(found, tmp_path) == {"fleet/n": "rosrun p driver 2"}
    assert said(found, "argument") == ["no launch file that was read declares `b`"]
    assert commands(of_ros1(tmp_path, body, environment={"ROS_NAMESPACE": "x"}), tmp_path) == {
        "x/n": "rosrun p driver 1"
    }


def test_places_have_lines_and_columns(tmp_path: Path) -> None:
    found = of_ros1(tmp_path, f'  <param name="a" value="x" type="int"/>\n{NODE}')
    finding = next(each for each in found.findings if each.kind == "refused").to_json()
    assert (finding["line"], finding["column"]) == (2, 3) and os.path.basename(finding["file"]) == "robot.launch"
    assert kinds(found)[0] == "refused"
