"""Typical mistakes: each is reported once, at its place, with what to write instead, and nothing else is reported."""

from __future__ import annotations

from typing import NamedTuple

import pytest

from midstride.lang import load_text, render
from midstride.lang.message_types import installed

from .test_errors import marked

RIGHT = """system robot

contract Distance = sensor_msgs/msg/Range @ 20 Hz

topic /raw    : Distance
topic /smooth : Distance
topic /stop   : std_msgs/msg/Bool @ 10 Hz

component Sensor {
  run "python3 sensor.py"
  output out
  functionality measure {
    produces out
    mode normal { guarantee out : Distance }
    mode off { }
  }
}

component Mean {
  run "python3 mean.py"
  input  in : Distance
  output out
  functionality smooth {
    uses in
    produces out
    mode normal { assume in   guarantee out : Distance }
    mode off { }
  }
}

component Brake {
  run "python3 brake.py"
  input  distance : Distance
  output stop
  functionality watch weight 10 {
    uses distance
    produces stop
    mode normal   { assume distance   guarantee stop : std_msgs/msg/Bool @ 10 Hz }
    mode cautious { guarantee stop : std_msgs/msg/Bool @ 10 Hz }
  }
}

node sensor : Sensor { out -> /raw }
node filter : Mean   { in <- /raw   out -> /smooth }
node brake  : Brake  { distance <- /smooth   stop -> /stop }
"""


class Mistake(NamedTuple):
    """``wrong``, written instead of ``right``, with a mark at the expected place; parts of message and help."""

    right: str
    wrong: str
    message: str
    help: str | None


MISTAKES = {
    "a misspelt component": Mistake(
        "filter : Mean", "filter : ‹E008›Maen", "there is no component `Maen`", "did you mean `Mean`?"
    ),
    "a misspelt port": Mistake("{ distance <-", "{ ‹E008›distanc <-", "Brake has no port `distanc`", "`distance`?"),
    "a misspelt topic": Mistake(
        "<- /smooth", "<- ‹E008›/smoth", "there is no topic `/smoth`", "did you mean `/smooth`?"
    ),
    "an input of almost the name of a contract": Mistake(
        "assume distance",
        "assume ‹E008›distnce",
        "neither an input of Brake nor a contract",
        "did you mean `distance`?",
    ),
    "a topic without a declaration": Mistake(
        "stop -> /stop", "stop -> ‹E008›/brake_now", "no topic `/brake_now`", "declare it: `topic /brake_now : TYPE`"
    ),
    "a topic of the namespace around": Mistake(
        "node filter",
        "namespace a { node b : Brake { distance <- ‹E008›smooth   stop -> /stop } }\nnode filter",
        "there is no topic `/a/smooth`",
        "did you mean `/smooth`?",
    ),
    "a type with another name": Mistake(
        "topic /stop   : std_msgs/msg/Bool",
        "topic /stop   : ‹E130›std_msgs/msg/Boolean",
        "no message type `Boolean`",
        "did you mean `Bool`?",
    ),
    "an unknown type": Mistake(
        "topic /stop   : std_msgs/msg/Bool",
        "topic /stop   : ‹E130›std_msgs/msg/Flag",
        "no message type `Flag`",
        "its types: Bool, Byte,",
    ),
    "a type as in Python": Mistake(
        "topic /stop   : std_msgs/msg/Bool",
        "topic /stop   : ‹E133›std_msgs.msg.Bool",
        "is not a message type",
        "write `std_msgs/msg/Bool`",
    ),
    "a type as in C++": Mistake(
        "topic /stop   : std_msgs/msg/Bool",
        "topic /stop   : ‹E133›std_msgs::msg::Bool",
        "is not a message type",
        "write `std_msgs/msg/Bool`",
    ),
    "the unit of a time for a rate": Mistake(
        "@ 20 Hz", "@ 20 ‹E127›ms", "`ms` is not a valid unit for a rate", "write `20 Hz`"
    ),
    "no unit": Mistake("@ 20 Hz", "@ ‹E127›20", "a rate needs a unit", "write `20 Hz`"),
    "a missing brace": Mistake(
        "    mode off { }\n  }\n}\n\ncomponent Mean",
        "    mode off { }\n  }‹E123›\n\ncomponent Mean",
        "component `Sensor` is not closed: expected `}` before `component`",
        None,
    ),
    "an extra brace": Mistake(
        '"python3 sensor.py"', '"python3 sensor.py" ‹E124›}', "closes component `Sensor` before `output`", "remove it"
    ),
    "a missing quote": Mistake(
        '"python3 sensor.py"', '‹E113›"python3 sensor.py', "unterminated string", 'end it with `"` on the same line'
    ),
    "a command without quotes": Mistake(
        '"python3 sensor.py"', "‹E120›python3 sensor.py", "in double quotes", 'write `run "python3 sensor.py"`'
    ),
    "a semicolon": Mistake("/raw    : Distance", "/raw    : Distance‹E110›;", "unexpected character `;`", "remove it"),
    "a comment of C": Mistake(
        "20 Hz", "20 Hz ‹E110›// fast", "`//` does not start a comment", "comments start with `#`"
    ),
    "a colon as in YAML": Mistake(
        "component Sensor", "component‹E120›: Sensor", "expected a component name, found `:`", "remove it"
    ),
    "a capital": Mistake(
        "component Sensor", "‹E121›Component Sensor", "unknown statement `Component`", "did you mean `component`?"
    ),
    "an equals sign for a colon": Mistake(
        "guarantee stop : std_msgs/msg/Bool @ 10 Hz }\n    mode",
        "guarantee stop ‹E120›= std_msgs/msg/Bool @ 10 Hz }\n    mode",
        "expected `:` after `stop`, found `=`",
        None,
    ),
    "two nodes of one name": Mistake(
        "node brake  :", "node ‹E007›filter  :", "node `filter` is already declared", "use another name"
    ),
    "modes in the wrong order": Mistake(
        "    mode normal   { assume distance   guarantee stop : std_msgs/msg/Bool @ 10 Hz }\n"
        "    mode cautious { guarantee stop : std_msgs/msg/Bool @ 10 Hz }\n",
        "    mode cautious { guarantee stop : std_msgs/msg/Bool @ 10 Hz }\n"
        "    mode ‹E010›normal   { assume distance   guarantee stop : std_msgs/msg/Bool @ 10 Hz }\n",
        "mode normal, the last of watch, must assume nothing",
        "modes are listed best first: put cautious, which assumes nothing, last",
    ),
    "a worse mode that guarantees more": Mistake(
        "cautious { guarantee stop : std_msgs/msg/Bool @ 10 Hz }",
        "cautious { guarantee stop : std_msgs/msg/Bool @ 20 Hz }",
        "mode cautious of watch guarantees stop : std_msgs/msg/Bool @ 20 Hz, which the better mode normal does not",
        "guarantee at least that in normal",
    ),
    "one mode": Mistake(
        "functionality measure {\n    produces out\n    mode normal { guarantee out : Distance }\n    mode off { }",
        "functionality ‹E015›measure {\n    produces out\n    mode normal { guarantee out : Distance }",
        "nothing to degrade to",
        "add a last mode that assumes nothing",
    ),
    "an input that is not used": Mistake(
        "    uses distance\n", "", "watch does not use distance", "add distance to what watch `uses`"
    ),
    "an output that is not produced": Mistake(
        "    produces stop\n", "", "watch does not produce stop", "add stop to what watch `produces`"
    ),
    "a port that is not attached": Mistake(
        "node filter : Mean   { in <- /raw   out",
        "node ‹W030›filter : Mean { out",
        "input filter.in is attached to no topic",
        "`in <- /raw`",
    ),
    "an insufficient rate": Mistake(
        "input  distance : Distance",
        "input  distance : sensor_msgs/msg/Range @ 50 Hz",
        "rate: 20 Hz is offered, at least 50 Hz is needed",
        "strengthen what is offered",
    ),
    "an insufficient QoS": Mistake(
        "topic /raw    : Distance",
        "topic /raw    : sensor_msgs/msg/Range @ 20 Hz qos(reliability = best_effort)",
        "reliability: best_effort is offered, reliable is needed",
        "strengthen what is offered",
    ),
    "a misspelt policy": Mistake(
        "@ 20 Hz",
        "@ 20 Hz qos(‹E131›reliabilty = reliable)",
        "no QoS policy `reliabilty`",
        "did you mean `reliability`?",
    ),
    "a misspelt field": Mistake(
        "@ 20 Hz", "@ 20 Hz where ‹E137›rnge >= 0.5", "has no field `rnge`", "did you mean `range`?"
    ),
    "a constant by its name": Mistake(
        "@ 20 Hz",
        "@ 20 Hz where ‹E138›radiation_type = INFRARED",
        "is a number",
        "the value of the constant: `radiation_type = 1`",
    ),
    "a missing file": Mistake(
        "contract Distance",
        'include ‹E100›"parts/lidar.stride"\ncontract Distance',
        "no such file",
        "the path is relative to this file: `parts/lidar.stride`",
    ),
    "a parameter without a declaration": Mistake(
        "in <- /raw ",
        "parameters { ‹E008›window = 3 } in <- /raw ",
        "Mean has no parameter `window`",
        "declare it in Mean: `parameters { window = … }`",
    ),
    "a parameter with a unit": Mistake(
        '"python3 mean.py"',
        '"python3 mean.py" parameters { span = 5 ‹E120›s, mean = 1 }',
        "cannot have a unit",
        "write `span = 5`",
    ),
    "a parameter with a colon": Mistake(
        '"python3 mean.py"',
        '"python3 mean.py" parameters { span‹E120›: 5, mean = 1 }',
        "expected `=` after `span`",
        None,
    ),
    "a resource without a declaration": Mistake(
        '"python3 mean.py"', '"python3 mean.py" holds ‹E008›gpu 2', "no resource `gpu`", "declare it: `resource gpu ="
    ),
    "a node for a functionality": Mistake(
        "node sensor", "keep brake ‹E120›at normal\nnode sensor", "expected `.` after `brake`", None
    ),
    "two assumptions in one statement": Mistake(
        "{ assume distance ",
        "{ assume distance, ‹E120›distance ",
        "expected `assume` before `distance`",
        "write `assume distance`",
    ),
    "two assumptions with `and`": Mistake(
        "{ assume distance ",
        "{ assume distance and ‹E120›distance ",
        "expected `assume` before `distance`",
        "write `assume distance`",
    ),
    "a time without a unit": Mistake(
        "node sensor", "limit brake.watch below baseline ‹E127›2\nnode sensor", "a time needs a unit", "write `2 s`"
    ),
    "a cycle of orders": Mistake(
        "node sensor",
        "order sensor before filter\n‹E024›order filter before sensor\nnode sensor",
        "contradicts `order sensor before filter`",
        "remove one of them",
    ),
    "an arrow in the wrong direction": Mistake(
        "{ in <- /raw", "{ ‹E144›in -> /raw", "is an input", "write `in <- /raw`"
    ),
}

# Mistakes that are reported elsewhere: at the attachment, or where the port is used.
ELSEWHERE = {
    "an insufficient rate": ("{ distance <- /smooth", "{ distance <- ‹E020›/smooth"),
    "an insufficient QoS": ("{ in <- /raw", "{ in <- ‹E020›/raw"),
    "an input that is not used": ("assume distance", "assume ‹E008›distance"),
    "an output that is not produced": ("distance   guarantee stop", "distance   guarantee ‹E008›stop"),
    "a worse mode that guarantees more": ("distance   guarantee stop", "distance   guarantee ‹E011›stop"),
}


def test_the_correct_file_has_no_diagnostics() -> None:
    assert load_text(RIGHT, "robot.stride", messages=installed({})).diagnostics == ()


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_reported_once_at_its_place_with_what_to_write_instead(name: str) -> None:
    mistake = MISTAKES[name]
    assert RIGHT.count(mistake.right) == 1 or mistake.right in {"20 Hz", "@ 20 Hz"}
    text = RIGHT.replace(mistake.right, mistake.wrong, 1)
    if name in ELSEWHERE:
        text = text.replace(*ELSEWHERE[name], 1)
    plain, expected = marked(text)
    found = load_text(plain, "robot.stride", messages=installed({})).diagnostics
    shown = render(found)
    assert len(expected) == 1
    follows = [d for d in found if d.code == "W033"]  # the consequences of a warning are reported separately
    direct = [d for d in found if d not in follows]
    assert [(d.code, *d.position) for d in direct] == expected, shown
    assert not follows or direct[0].severity == "warning", shown
    assert mistake.message in direct[0].message, shown
    assert (direct[0].help is None) if mistake.help is None else (mistake.help in (direct[0].help or "")), shown


def test_a_second_guarantee_in_one_statement_is_reported_and_taken_as_meant() -> None:
    text = (
        "system s\ncomponent C { output a output b functionality f { produces a, b\n"
        "  mode normal { guarantee a : std_msgs/msg/String @ 1 Hz, b : std_msgs/msg/String }\n  mode off { } } }\n"
    )
    (found,) = load_text(text, "s.stride", messages=installed({})).diagnostics
    assert (found.code, found.message, found.help) == (
        "E120",
        "expected `guarantee` before `b`",
        "write `guarantee b : …`",
    )


def test_many_mistakes_are_reported_together() -> None:
    """Eight independent mistakes in one file."""
    text = RIGHT
    for name in (
        "a misspelt port",
        "no unit",
        "a type with another name",
        "an extra brace",
        "an equals sign for a colon",
        "an arrow in the wrong direction",
        "a parameter with a colon",
        "a time without a unit",
    ):
        text = text.replace(MISTAKES[name].right, MISTAKES[name].wrong, 1)
    plain, expected = marked(text)
    found = load_text(plain, "robot.stride", messages=installed({})).diagnostics
    assert [(d.code, *d.position) for d in found] == expected, render(found)
    assert len(expected) == 8
