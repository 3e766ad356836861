"""Skeletons: they declare what the specification states, and regeneration keeps the user's code."""

from __future__ import annotations

import ast
import importlib.util
import shlex
import shutil
import subprocess
import sys
import types
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree

import pytest
from hypothesis import HealthCheck, given, settings

from midstride.errors import SpecificationError
from midstride.generate.generated_names import program, snake
from midstride.generate.merge import BEGIN, END, merge_component, merge_copy, merge_whole
from midstride.generate.project import project
from midstride.lang import load, load_text
from midstride.model.component import ComponentSpec, FunctionalitySpec, InputAlternatives, Mode
from midstride.model.contract import Interval, Predicate
from midstride.model.specification import Specification
from midstride.runtime.process.registration import mismatches
from tests.strategies.systems import components

SEEDS = Path(__file__).parents[1] / "lang" / "seeds"
SAMPLE = load(SEEDS / "patrol.stride").require()


def message_module(package: str, *names: str) -> types.ModuleType:
    """Message classes with any field that is accessed."""

    def attributes(self: object, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return type("Field", (), {"__getattr__": attributes})()

    module = types.ModuleType(f"{package}.msg")
    for name in names:
        members = {"__msgtype__": f"{package}/msg/{name}", "__getattr__": attributes}
        setattr(module, name, type(name, (), members))
    return module


@pytest.fixture
def messages(monkeypatch: pytest.MonkeyPatch) -> None:
    for package, names in {
        "demo_msgs": "AB",
        "sensor_msgs": ("LaserScan", "Range"),
        "geometry_msgs": ("Twist",),
        "std_msgs": ("String",),
        "other_msgs": ("String",),
    }.items():
        monkeypatch.setitem(sys.modules, package, types.ModuleType(package))
        monkeypatch.setitem(sys.modules, f"{package}.msg", message_module(package, *names))


def skeletons(specification: Specification) -> dict[str, str]:
    files = project(specification, "s.stride", {}).files
    return {str(file.path): file.text for file in files if file.kind == "component"}


def registered(text: str, name: str) -> ComponentSpec:
    """The declaration that a program with that text would register."""
    namespace: dict[str, Any] = {"__name__": "generated"}
    exec(compile(text, "generated.py", "exec"), namespace)
    made = namespace[name]()
    made.wire()
    for method in ast.walk(ast.parse(text)):
        assert (
            not isinstance(method, ast.FunctionDef)
            or ast.get_docstring(method) is not None
            or method.name == "__init__"
        )
    found: ComponentSpec = made.component.declaration()
    return found


@pytest.mark.usefixtures("messages")
@pytest.mark.parametrize("name", sorted(SAMPLE.components))
def test_the_skeletons_of_the_sample_match_its_declarations(name: str) -> None:
    paths = {
        "Lidar": "lidar",
        "ObstacleDetector": "detector",
        "StereoDetector": "stereo",
        "MotorController": "controller",
    }
    text = skeletons(SAMPLE)[f"patrol/{paths[name]}.py"]
    assert mismatches(SAMPLE.components[name], registered(text, name)) == []


@pytest.mark.usefixtures("messages")
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(components(kinds=("topic",)))
def test_the_skeleton_of_any_component_matches_its_declaration(component: ComponentSpec) -> None:
    if any(component.output_endpoint(output) is None for output in component.outputs):
        with pytest.raises(SpecificationError, match="has no type"):
            skeletons(of(component))
        return
    (text,) = skeletons(of(component)).values()
    assert mismatches(component, registered(text, component.name)) == []


@pytest.mark.usefixtures("messages")
def test_servers_and_clients_are_declared_with_their_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    services = types.ModuleType("demo_msgs.srv")
    for name in ("GetMap", "Count"):
        parts = {part: type(part, (), {}) for part in ("Request", "Response")}
        setattr(services, name, type(name, (), {"__module__": f"demo_msgs.srv._{snake(name)}", **parts}))
    monkeypatch.setitem(sys.modules, "demo_msgs.srv", services)
    declared = (
        load_text(
            """system s component C {
              run "python3 node.py"   output out   server count
              client map : demo_msgs/srv/GetMap responds within 0.1 s
              input a : demo_msgs/msg/A
              functionality f {
                uses map, a   produces out, count
                mode normal {
                  assume map   assume a
                  guarantee out : demo_msgs/msg/B
                  guarantee count : demo_msgs/srv/Count responds within 50 ms
                }
                mode slow { assume map   guarantee count : demo_msgs/srv/Count responds within 1 s }
                mode off { }
              }
            }"""
        )
        .require()
        .components["C"]
    )
    (text,) = skeletons(of(declared)).values()
    assert mismatches(declared, registered(text, "C")) == []
    assert "create_client('map', GetMap, within=0.1)" in text
    assert "create_server('count', Count, self.answer_count, within=0.05)" in text


@pytest.mark.usefixtures("messages")
def test_numbers_of_many_digits_are_written_as_they_are() -> None:
    declared = (
        load_text(
            """system s component C {
              run "python3 node.py"   output out
              input in : sensor_msgs/msg/Range @ 33.3333333 Hz where range in [0.1234567, 7654321]
              functionality f weight 1.23456789 {
                uses in   produces out
                mode normal {
                  assume in   guarantee out : sensor_msgs/msg/Range @ 16.6666667 Hz where range >= 1234567
                }
                mode degraded { }
              }
            }"""
        )
        .require()
        .components["C"]
    )
    (text,) = skeletons(of(declared)).values()
    assert mismatches(declared, registered(text, "C")) == []


@pytest.mark.usefixtures("messages")
def test_a_field_may_have_any_number() -> None:
    anything = Predicate("sensor_msgs/msg/Range", fields=(("range", Interval()),))
    work = FunctionalitySpec("work", (Mode("normal", (InputAlternatives(("in",)),)), Mode("degraded")), ("in",))
    declared = ComponentSpec.of("C", inputs={"in": anything}, functionalities=(work,))
    (text,) = skeletons(of(declared)).values()
    assert mismatches(declared, registered(text, "C")) == []


def of(component: ComponentSpec) -> Specification:
    from dataclasses import replace

    from immutables import Map

    return Specification("s", components=Map({component.name: replace(component, run="python3 node.py")}))


@pytest.mark.usefixtures("messages")
def test_awkward_names_and_types() -> None:
    specification = load_text(
        """system s
        component Component {
          run "python3 -u -m a.b.c --verbose"
          parameters { start = 1, changeable class = "x", a.b = [1, 2] }
          input in : std_msgs/msg/String
          input wire : other_msgs/msg/String @ 2 Hz
          output out
          functionality in {
            uses in, wire
            produces out
            mode normal { assume in   assume wire   guarantee out : std_msgs/msg/String where data in {"a", "b"} }
            mode for { assume in or wire   guarantee out : std_msgs/msg/String where data = "a" }
            mode degraded { }
          }
          functionality lone { uses in   mode a { assume in }   mode b { } }
        }
        """.replace('where data = "a" }', 'where data in {"a", "b"} }')
    ).require()
    (path,) = skeletons(specification)
    assert path == "a/b/c.py"
    text = skeletons(specification)[path]
    assert mismatches(specification.components["Component"], registered(text, "ComponentNode")) == []


@pytest.mark.parametrize(
    ("run", "path"),
    [
        ("python3 -m patrol.detector", "patrol/detector.py"),
        ("python3 talker.py --loud", "talker.py"),
        ("/usr/bin/env python3 -u nodes/talker.py", "nodes/talker.py"),
        ("python3.11 -B talker.py", "talker.py"),
        ("ros2 run pkg node", None),
        ("python3 -c 'print(1)'", None),
        ("python3 /abs/talker.py", None),
        ("python3 ../talker.py", None),
        ("python3 -m a.class", None),
        ("./talker", None),
        ("python3 'unclosed", None),
    ],
)
def test_which_file_a_command_runs(run: str, path: str | None) -> None:
    found = program(run)
    assert (None if found is None else found.path) == (None if path is None else PurePosixPath(path))
    assert found is None or found.packaged == ("-m" in run)


def test_names_in_snake_case() -> None:
    assert [snake(name) for name in ("ObstacleDetector", "HTTPServer", "Lidar2D", "a")] == [
        "obstacle_detector",
        "http_server",
        "lidar2_d",
        "a",
    ]


def test_components_without_a_skeleton_have_a_reason() -> None:
    text = (
        'system s\ncomponent A { }\ncomponent B { run "./b" }\ncomponent C { run "python3 c.py" }\ncomponent D like C\n'
    )
    made = project(load_text(text).require(), "s.stride", {})
    assert made.skipped == {
        "A": "it has no `run` command: it is started elsewhere",
        "B": "`./b` does not run a Python file in this folder",
        "D": "it runs c.py, which is the program of C",
    }


COMPOSED = """system composed
topic /image : sensor_msgs/msg/Image @ 10 Hz

component Camera {
  run component "camera::Camera" package "camera_driver" gate preload
  output out as image
  functionality see {
    produces out
    mode normal { guarantee out : sensor_msgs/msg/Image @ 10 Hz }
    mode off { }
  }
}
component Viewer {
  run "viewer" package "image_view" gate preload
  input in : sensor_msgs/msg/Image @ 10 Hz as image
  functionality show { uses in   mode normal { assume in }   mode off { } }
}
container vision { run "own_container" package "vision_bringup" }
node camera : Camera in vision { out -> /image }
node viewer : Viewer { in <- /image }
"""


def test_a_package_depends_on_what_its_containers_load_and_its_nodes_run() -> None:
    specification = load_text(COMPOSED).require()
    made = project(specification, "composed.stride", {PurePosixPath("composed.stride"): COMPOSED})
    assert made.skipped == {
        "Camera": "it is a composable node, whose code is in the package camera_driver",
        "Viewer": "its program does not use Midstride's API: it has a gate",
    }
    texts = {str(file.path): file.text for file in made.files}
    depends = [each.text for each in ElementTree.fromstring(texts["package.xml"]).iter("exec_depend")]
    alone = ["camera_driver", "composition_interfaces", "image_view", "rclcpp_components", "vision_bringup"]
    assert depends == ["rclpy", *alone, "launch"]
    assert texts["composed.stride"] == COMPOSED, "it states the container, which `midstride up` starts"
    assert '("share/composed", ["package.xml"])' in texts["setup.py"].replace("'", '"')
    with pytest.raises(SpecificationError, match="Camera: ROS 1 has no composable nodes"):
        project(specification, "composed.stride", {}, 1)


# -- the user's code -----------------------------------------------------------------------------------

OLD = load_text(
    """system s
    component Talker {
      run "python3 talker.py"
      output out
      functionality talk { produces out
        mode normal { guarantee out : std_msgs/msg/String @ 10 Hz }   mode silent { } }
    }
    """
).require()
NEW = load_text(
    """system s
    component Talker {
      run "python3 talker.py"
      output out
      functionality talk { produces out   mode normal { guarantee out : std_msgs/msg/String @ 10 Hz }
        mode rarely { guarantee out : std_msgs/msg/String @ 1 Hz }   mode silent { } }
    }
    """
).require()


def test_the_block_is_rewritten_and_the_rest_kept() -> None:
    (old,), (new,) = skeletons(OLD).values(), skeletons(NEW).values()
    mine = old.replace(
        'assumes nothing."""\n        self.out.write(String())\n\n    def talk_silent',
        'assumes nothing."""\n        self.out.write(String(data="mine"))\n\n    def helper(self) -> int:\n'
        "        return 1  # kept\n\n    def talk_silent",
    )
    head, _, tail = mine.partition(END)
    tail = tail.replace('"""Your code', '# a note\n    """Your code')
    mine = "# a header of mine\n" + head + END + tail + "\nprint('bye')\n"
    assert mine.count("mine") >= 2
    merged = merge_component(mine, new)
    assert merged.text is not None
    assert merged.note == "new: talk_rarely"
    assert "self.talk.set_mode('rarely'" in merged.text
    for line in mine.partition(END)[2].split("\n"):
        assert line in merged.text.partition(END)[2].split("\n")
    assert merged.text.startswith("# a header of mine\n")
    assert merged.text.count("def talk_rarely") == 2
    assert merge_component(merged.text, new).text is None
    compile(merged.text, "merged.py", "exec")


@pytest.mark.parametrize("indent", ["  ", "\t", "    "])
def test_new_methods_are_indented_as_the_user_s_are(indent: str) -> None:
    """By two spaces, a method that is indented by four would be inside the one before it."""
    (old,), (new,) = skeletons(OLD).values(), skeletons(NEW).values()
    head, _, tail = old.partition(END)
    merged = merge_component(head + END + tail.replace("    ", indent), new)
    assert merged.text is not None and merged.note == "new: talk_rarely"
    classes = [each for each in ast.parse(merged.text).body if isinstance(each, ast.ClassDef)]
    assert "talk_rarely" in [each.name for each in classes[-1].body if isinstance(each, ast.FunctionDef)]
    assert merge_component(merged.text, new).text is None


def test_a_class_on_one_line_gets_no_methods_and_it_is_said() -> None:
    (old,), (new,) = skeletons(OLD).values(), skeletons(NEW).values()
    merged = merge_component(old.partition(END)[0] + END + "\n\n\nclass Talker(TalkerBase): pass\n", new)
    assert merged.text is not None and "on the line of its name: no methods added" in merged.note
    compile(merged.text, "merged.py", "exec")


def test_a_file_without_marks_or_valid_python_is_left_to_the_user() -> None:
    (new,) = skeletons(NEW).values()
    (old,) = skeletons(OLD).values()
    assert merge_component("print('all mine')\n", new) == merge_component(new.replace(BEGIN, ""), new)
    assert merge_component("print('all mine')\n", new).text is None
    broken = merge_component(old + "def (:\n", new)
    assert broken.text is not None
    assert broken.text.endswith("def (:\n")
    assert "no methods added" in broken.note
    renamed = merge_component(old.replace("class Talker(", "class Mine("), new)
    assert "no class Talker" in renamed.note


def test_the_block_of_an_earlier_version_is_recognised() -> None:
    """The marks are found by their beginnings, because their wording has changed before."""
    (old,), (new,) = skeletons(OLD).values(), skeletons(NEW).values()
    earlier = old.replace(BEGIN, "# >>> midstride: written anew each time").replace(END, "# <<< midstride: yours")
    merged = merge_component(earlier, new)
    assert merged == merge_component(old, new)
    assert merged.text is not None
    assert (merged.text.count(BEGIN), merged.text.count(END), merged.text.count("# >>>")) == (1, 1, 1)


def test_other_files_are_the_users_once_edited() -> None:
    (old,) = [file.text for file in project(OLD, "s.stride", {}).files if file.path.name == "setup.py"]
    (new,) = [file.text for file in project(NEW, "t.stride", {}, ros=1).files if file.path.name == "setup.py"]
    assert merge_whole(None, new).text == new
    assert merge_whole(old, old).text is None
    assert merge_whole(old, new).text == new
    edited = merge_whole(old.replace("0.1.0", "0.2.0"), new)
    assert (edited.text, edited.note) == (None, "edited, left unchanged")
    assert merge_copy("a", "b", None).text is None


@pytest.mark.parametrize(
    "name", ["a & b", "<robot>", "it's", 'say "hi"', '"""', "back\\slash", "$HOME ${HOME}", "a;b", "ü"]
)
def test_files_of_any_name_are_quoted(name: str) -> None:
    file, text = f"{name}.stride", 'component A { run "python3 a.py" }'
    sources = {PurePosixPath(file): "", PurePosixPath(name, "parts.stride"): ""}
    made = project(load_text(f"system s\n{text}").require(), file, sources, ros=1)
    files = {str(each.path): each.text for each in made.files}
    described = ElementTree.fromstring(files["package.xml"]).findtext("description")
    assert described == f"The system s, described in {file}"
    node = ElementTree.fromstring(files["launch/s.launch"]).find("node")
    assert node is not None and shlex.split(node.attrib["args"]) == [f"package://s/{file}"]
    ast.parse(files["a.py"])
    second = project(SAMPLE, file, sources)
    described = next(each.text for each in second.files if each.path.name == "package.xml")
    assert file in str(ElementTree.fromstring(described).findtext("description"))


@pytest.mark.skipif(shutil.which("cmake") is None, reason="needs cmake")
def test_files_of_any_name_are_installed_by_cmake(tmp_path: Path) -> None:
    """As catkin would, which only says where. Names with `"`, `\\` or `$` CMake itself cannot install."""
    names = ["a & b.stride", "it's (new) #1.stride", "ü.stride"]
    sources = {PurePosixPath(folder, name): "" for name in names for folder in ("", "a part")}
    made = project(load_text("system s").require(), names[0], sources, ros=1)
    for each in made.files:
        path = tmp_path / "source" / each.path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(each.text, encoding="utf-8")
    lists = tmp_path / "source" / "CMakeLists.txt"
    catkin = 'set(CATKIN_PACKAGE_BIN_DESTINATION bin)\nset(CATKIN_PACKAGE_SHARE_DESTINATION "share")'
    lines = [line for line in lists.read_text(encoding="utf-8").splitlines() if "catkin" not in line]
    lists.write_text("\n".join(lines).replace("project(s)", f"project(s NONE)\n{catkin}"), encoding="utf-8")
    for command in (["-S", "source", "-B", "build", "-DCMAKE_INSTALL_PREFIX=prefix"], ["--install", "build"]):
        subprocess.run(["cmake", *command], cwd=tmp_path, check=True, capture_output=True)
    share = tmp_path / "prefix" / "share"
    installed = {PurePosixPath(path.relative_to(share)) for path in share.rglob("*.stride")}
    assert installed == set(sources)


class _Recorded:
    """Stands in for a class of the ROS package ``launch``, which cannot be installed with pip: keeps its arguments."""

    def __init__(self, **arguments: Any) -> None:
        self.__dict__.update(arguments)


class LaunchDescription(_Recorded):
    def __init__(self, initial_entities: list[Any]) -> None:
        super().__init__(entities=initial_entities)


class ExecuteProcess(_Recorded):
    def __init__(self, *, cmd: list[str], output: str = "log", emulate_tty: bool = False) -> None:
        super().__init__(cmd=cmd, output=output, emulate_tty=emulate_tty)


class OpaqueFunction(_Recorded):
    def __init__(self, *, function: Callable[[object], Any]) -> None:
        super().__init__(function=function)


class OnShutdown(_Recorded):
    def __init__(self, *, on_shutdown: list[Any]) -> None:
        super().__init__(on_shutdown=on_shutdown)


class RegisterEventHandler(_Recorded):
    def __init__(self, event_handler: OnShutdown) -> None:
        super().__init__(event_handler=event_handler)


def launch_description() -> Any:
    (text,) = [file.text for file in project(OLD, "s.stride", {}).files if file.path.name == "s.launch.py"]
    namespace: dict[str, Any] = {"__file__": "/ws/share/s/launch/s.launch.py"}
    exec(compile(text, "s.launch.py", "exec"), namespace)
    return namespace["generate_launch_description"]()


def test_the_launch_file_starts_the_system_and_ends_it_with_the_launch(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, classes in {
        "launch": (LaunchDescription,),
        "launch.actions": (ExecuteProcess, OpaqueFunction, RegisterEventHandler),
        "launch.event_handlers": (OnShutdown,),
    }.items():
        module = types.ModuleType(name)
        vars(module).update({one.__name__: one for one in classes})
        monkeypatch.setitem(sys.modules, name, module)
    described = launch_description()
    assert type(described) is LaunchDescription
    up, registered = vars(described)["entities"]
    assert type(up) is ExecuteProcess
    assert vars(up) == {"cmd": ["midstride", "up", "package://s/s.stride"], "output": "screen", "emulate_tty": True}
    (down,) = registered.event_handler.on_shutdown
    commands: list[list[str]] = []
    monkeypatch.setattr(subprocess, "run", lambda command, check: commands.append(command))
    assert down.function(object()) is None
    assert commands == [["midstride", "down", "--system", "s"]]


if importlib.util.find_spec("launch") is not None:  # only a distribution's ROS 2 has it

    def test_the_launch_file_is_accepted_by_ros_launch() -> None:
        launch = importlib.import_module("launch")
        assert isinstance(launch_description(), launch.LaunchDescription)
