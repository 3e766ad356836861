"""Composable nodes in launch files: in their containers, or each with its process, or left out and named."""

from __future__ import annotations

from pathlib import Path

from midstride.launch_files.launch_import import Imported, import_launch_file
from midstride.launch_files.launched_containers import Containers
from midstride.model.component import DEFAULT_CONTAINER, ComponentSpec, ContainerProgram, StopTimes
from tests.launch_files.support import specification

PARAMETERS = """camera:
  ros__parameters: {rate: 30.0}
/**/costmap:
  ros__parameters: {width: 5}
"""
# A container with two components, a node that is one, and a container that is started elsewhere.
ROBOT = """
<push-ros-namespace namespace="front"/>
<node_container pkg="rclcpp_components" exec="component_container_mt" name="pipeline" namespace="" respawn="true">
  <env name="RMW" value="x"/>
  <composable_node pkg="cameras" plugin="cameras::Camera" name="camera">
    <param name="gain" value="2"/>
    <remap from="image" to="/image"/>
    <extra_arg name="use_intra_process_comms" value="true"/>
  </composable_node>
  <composable_node pkg="cameras" plugin="cameras::Rectify" name="rectify">
    <extra_arg name="use_intra_process_comms" value="true"/>
    <extra_arg name="enable_rosout" value="false"/>
  </composable_node>
  <composable_node pkg="cameras" plugin="cameras::Never" name="never" if="false"/>
</node_container>
<node pkg="rclcpp_components" exec="component_container_isolated" name="nav2_container" ros_args="--log-level warn">
  <param from="$(dirname)/nav.yaml"/>
</node>
<load_composable_node target="nav2_container">
  <composable_node pkg="nav2_planner" plugin="nav2_planner::PlannerServer" name="planner_server">
    <param from="$(dirname)/nav.yaml"/>
  </composable_node>
</load_composable_node>
<load_composable_node target="/elsewhere/box">
  <composable_node pkg="nav2_route" plugin="nav2_route::RouteServer" name="route_server" namespace="/other"/>
</load_composable_node>
<node pkg="tools" exec="watch" name="watch"/>
"""


def imported(folder: Path, body: str, containers: Containers) -> Imported:
    (folder / "nav.yaml").write_text(PARAMETERS, encoding="utf-8")
    file = folder / "robot.launch.xml"
    file.write_text(f"<launch>\n{body}\n</launch>\n", encoding="utf-8")
    return import_launch_file(file, {}, {}, folder / "imported.stride", containers=containers)


def split(folder: Path, body: str) -> Imported:
    return imported(folder, body, "split")


def components(found: Imported, folder: Path) -> dict[str, ComponentSpec]:
    system = specification(found, folder)
    return {node.role: system.components[node.component] for node in system.nodes.values()}


def test_components_get_a_process_each_and_their_containers_are_left_out(tmp_path: Path) -> None:
    found = split(tmp_path, ROBOT)
    nodes = components(found, tmp_path)
    assert set(nodes) == {"front/camera", "front/rectify", "front/planner_server", "other/route_server", "front/watch"}
    camera, rectify = nodes["front/camera"], nodes["front/rectify"]
    assert (camera.run, camera.package) == ("cameras::Camera -r image:=/image", "cameras")
    assert camera.container == ContainerProgram("component_container_mt", "rclcpp_components")
    assert dict(camera.environment) == {"RMW": "x"}
    assert camera.parameters["gain"].value == 2
    assert camera.gate == "preload"
    assert rectify.run == "cameras::Rectify -e enable_rosout:=false"
    assert nodes["front/watch"].container is None
    system = specification(found, tmp_path)
    assert system.nodes["front/camera"].respawn is not None


def test_they_share_their_containers_as_in_the_launch_file(tmp_path: Path) -> None:
    found = imported(tmp_path, ROBOT, "keep")
    system = specification(found, tmp_path)
    assert {name: each.run for name, each in system.containers.items()} == {
        "front/pipeline": "component_container_mt",
        "front/nav2_container": "component_container_isolated --ros-args --log-level warn",
        "elsewhere/box": "component_container",
    }
    assert {role: node.container for role, node in system.nodes.items()} == {
        "front/camera": "front/pipeline",
        "front/rectify": "front/pipeline",
        "front/planner_server": "front/nav2_container",
        "other/route_server": "elsewhere/box",
        "front/watch": None,
    }
    nodes = components(found, tmp_path)
    assert {nodes[role].container for role, node in system.nodes.items() if node.container} == {DEFAULT_CONTAINER}
    assert dict(system.containers["front/pipeline"].environment) == {"RMW": "x"}
    assert nodes["front/rectify"].run == "cameras::Rectify -e use_intra_process_comms:=true -e enable_rosout:=false"
    assert system.nodes["front/camera"].respawn is not None
    assert [each.message for each in found.findings if each.kind in ("composable", "unsupported")] == [
        "`front/camera`, `front/rectify` have intra-process communication: what they publish on a port with a gate is "
        "serialized all the same, and passes through the middleware",
        "the container `elsewhere/box` is started elsewhere; here it is `component_container`, with what is named for "
        "it alone",
    ]


def test_their_container_has_its_prefix_and_its_times_to_end(tmp_path: Path) -> None:
    body = """
<node_container pkg="rclcpp_components" exec="component_container" name="box" namespace="" sigterm_timeout="7"
                launch-prefix="nice">
  <composable_node pkg="cameras" plugin="cameras::Camera" name="camera"/>
</node_container>"""
    found = imported(tmp_path, body, "keep")
    system = specification(found, tmp_path)
    (tmp_path / "apart").mkdir()
    apart = components(imported(tmp_path / "apart", body, "split"), tmp_path / "apart")["camera"]
    shared = system.containers["box"]
    assert (shared.stop, shared.prefix) == (apart.stop, apart.prefix) == (StopTimes(sigterm=7.0), "nice")
    assert system.instance("camera").started.stop == apart.stop
    assert [each.message for each in found.findings if each.kind == "unsupported"] == []


def test_two_containers_never_get_one_name(tmp_path: Path) -> None:
    body = "".join(
        f"""
<node_container pkg="rclcpp_components" exec="component_container{kind}" name="{name}" namespace="">
  <composable_node pkg="cameras" plugin="cameras::{node}" name="{node}"/>
</node_container>"""
        for kind, name, node in (("", "camera", "camera"), ("_mt", "camera_container", "other"))
    )
    system = specification(imported(tmp_path, body, "keep"), tmp_path)
    programs = {role: system.containers[node.container].run for role, node in system.nodes.items() if node.container}
    assert programs == {"camera": "component_container", "other": "component_container_mt"}


def test_a_container_has_no_name_of_a_node_and_any_other_word_for_one(tmp_path: Path) -> None:
    body = """
<node_container pkg="rclcpp_components" exec="component_container" name="{}" namespace="">
  <composable_node pkg="cameras" plugin="cameras::Camera" name="camera"/>
</node_container>"""
    for name, expected in (("camera", "camera_container"), ("container", "container")):
        folder = tmp_path / name
        folder.mkdir()
        system = specification(imported(folder, body.format(name), "keep"), folder)
        assert set(system.containers) == {system.nodes["camera"].container} == {expected}


def test_an_extra_argument_that_no_run_text_can_state_is_left_out_and_named(tmp_path: Path) -> None:
    extra = [("list", "[1, 2]"), ("of", "[1]"), ("empty", ""), ("words", "a b"), ("large", str(2**64)), ("kept", "3")]
    found = split(
        tmp_path,
        '<load_composable_node target="/box"><composable_node pkg="cameras" plugin="cameras::Camera" name="camera">'
        + "".join(f'<extra_arg name="{name}" value="{value}"/>' for name, value in extra)
        + "</composable_node></load_composable_node>",
    )
    assert components(found, tmp_path)["camera"].run == "cameras::Camera -e kept:=3"
    said = [each.message for each in found.findings if each.kind == "unsupported"]
    assert [each.partition(":")[0] for each in said] == [
        f"the extra argument `{name}` is left out" for name, _ in extra[:-1]
    ]


def test_a_container_that_is_a_node_or_is_started_elsewhere(tmp_path: Path) -> None:
    nodes = components(split(tmp_path, ROBOT), tmp_path)
    planner, route = nodes["front/planner_server"], nodes["other/route_server"]
    program = "component_container_isolated --ros-args --log-level warn"
    assert planner.container == ContainerProgram(program, "rclcpp_components")
    assert route.container == ContainerProgram()


def test_what_changes_is_said(tmp_path: Path) -> None:
    said = [str(each) for each in split(tmp_path, ROBOT).findings if each.kind == "composable"]
    assert [each.partition("composable: ")[2] for each in said] == [
        "`front/camera`, `front/rectify` of the container `front/pipeline` get a process each, and the container is "
        "left out",
        "`front/camera`, `front/rectify` had intra-process communication: what they exchange is serialized now, and "
        "passes through the middleware",
        "`front/planner_server` of the container `front/nav2_container` gets a process of its own, and the container "
        "is left out",
        "`other/route_server` of the container `elsewhere/box`, which is started elsewhere, gets a process of its own, "
        "and the container is left out",
    ]


def test_parameter_files_of_a_container_alone_are_named(tmp_path: Path) -> None:
    body = """
<node_container pkg="rclcpp_components" exec="component_container" name="box" namespace="">
  <param from="$(dirname)/nav.yaml"/>
  <composable_node pkg="cameras" plugin="cameras::Camera" name=""/>
</node_container>"""
    found = split(tmp_path, body)
    said = [each.message for each in found.findings]
    assert any(each.startswith("`nav.yaml` of the container `box` are left out: ") for each in said), said
    assert "the component `cameras::Camera` has no name here, so its class gives it one; it is named `camera`" in said
    assert set(components(found, tmp_path)) == {"camera"}


def test_where_that_is_asked_for_they_are_left_out_and_named(tmp_path: Path) -> None:
    found = imported(tmp_path, ROBOT, "omit")
    assert set(components(found, tmp_path)) == {"front/pipeline", "front/nav2_container", "front/watch"}
    left_out = [each.message for each in found.findings if each.kind == "composable"]
    assert len(left_out) == 4
    assert left_out[0] == (
        "the component `cameras::Camera` is left out: it would share the process of its container; with "
        "`--containers keep` it does, and with `--containers split` it has its own"
    )


# What launch_ros 0.28 gives a component: of a file, its sections `/**` and `c` alone, the latter last, and a text in it
# is read twice; the value `nan` of the launch file is a text, which a node would get in a file, and read as a number.
OF_COMPONENT = """c: {ros__parameters: {both: 1, text: "'7'"}}
/**/c: {ros__parameters: {wild: 2}}
/**: {ros__parameters: {both: 3, all: 4}}
"""


def test_parameters_that_launch_gives_a_component_otherwise_than_a_node_are_named(tmp_path: Path) -> None:
    (tmp_path / "of.yaml").write_text(OF_COMPONENT, encoding="utf-8")
    body = """<node_container pkg="demo" exec="box" name="box" namespace="">
    <composable_node pkg="d" plugin="d::C" name="c">
      <param from="$(dirname)/of.yaml"/><param name="word" value="nan" type="str"/><param name="same" value="5"/>
    </composable_node></node_container>"""
    said = "\n".join(map(str, imported(tmp_path, body, "keep").findings))
    for name, launched, here in (
        ("both", "1", "3"),
        ("wild", "no value", "2"),
        ("word", "'nan'", "nan"),
    ):
        words = f"the parameter `{name}` of the component `c` {launched}, and here it has {here}, as a node would"
        assert words in said, said
    assert "`all`" not in said and "`same`" not in said


def test_parameters_of_a_component_that_are_those_of_a_node_are_not_named(tmp_path: Path) -> None:
    (tmp_path / "of.yaml").write_text(
        "/**: {ros__parameters: {a: 1, list: [1.0, 2.0], text: x, sub: {deep: true}}}\nc: {ros__parameters: {a: 2}}\n"
    )
    body = """<node_container pkg="demo" exec="box" name="box" namespace="">
    <composable_node pkg="d" plugin="d::C" name="c">
      <param from="$(dirname)/of.yaml"/><param name="text" value="other"/><param name="b" value="[1, 2]"/>
    </composable_node></node_container>"""
    assert "launch reads" not in "\n".join(map(str, imported(tmp_path, body, "keep").findings))


def test_a_list_for_all_nodes_is_one_for_a_component_and_a_text_for_a_node(tmp_path: Path) -> None:
    body = """<set_parameter name="list" value="[1, 2]"/><set_parameter name="flag" value="true"/>
    <node_container pkg="demo" exec="box" name="box" namespace="">
      <composable_node pkg="d" plugin="d::C" name="c"/>
    </node_container>"""
    said = "\n".join(map(str, imported(tmp_path, body, "keep").findings))
    assert "the parameter `list` of the component `c` [1, 2], and here it has '(1, 2)', as a node would" in said
    assert "`flag`" not in said
