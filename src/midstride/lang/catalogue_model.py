"""The part of the catalogue that is the model's (E001 to E099, W001 to W099): explanations and examples.

Titles and advice are in :mod:`midstride.model.diagnostics`. Each entry: the explanation, and the examples, whose parts
are those of :class:`midstride.lang.catalogue.Example`. The codes that only JSON can run into have examples in JSON.
"""

from __future__ import annotations

from typing import Final

from midstride.lang.catalogue_text import TALKER, Parts

_JSON: Final = "example.json"
_LISTENER: Final = """component Listener {
  input in : std_msgs/msg/String @ 5 Hz
  functionality listen {
    uses in
    mode normal { assume in }
    mode deaf   { }
  }
}
"""
_TOPIC: Final = "topic /chatter : std_msgs/msg/String @ 10 Hz\n"
_START: Final = "system s\n" + _TOPIC + TALKER
_TALKING: Final = _START + "node talker : Talker { out -> /chatter }\n"
_PAIR: Final = _TALKING + _LISTENER + "node listener : Listener { in <- /chatter }\n"


def _component(body: str) -> str:
    return "system s\ncomponent C {\n" + body + "}\n"


MODEL: Final[dict[str, tuple[str, tuple[Parts, ...]]]] = {
    "E001": (
        """A value of the JSON form has another type than its key asks for, or the file is no JSON at all.""",
        (('{"system": 5}\n', _JSON), ('{"system": "s"\n', _JSON), ('{"system": "s", "nodes": []}\n', _JSON)),
    ),
    "E002": (
        """The JSON form has no such key here. Near misses are suggested.""",
        (('{"system": "s", "topic": {}}\n', _JSON),),
    ),
    "E003": ("""The JSON form needs a key that is not there.""", (("{}\n", _JSON),)),
    "E004": (
        """The number is not finite, or below what its meaning allows: rates and capacities are more than 0, times and
        weights not less.""",
        (
            (_TALKING + "resource memory = -1\n",),
            (_TALKING + "limit talker.talk below baseline -1 s\n",),
            (_TALKING.replace("talk {", "talk weight -1 {"),),
            (_TALKING.replace("  output", "  holds memory -1\n  output") + "resource memory = 4\n",),
            (_TALKING + "timing { create -1 s }\n",),
            ("system s\ntopic /chatter : std_msgs/msg/String qos(deadline = 0 s)\n",),
            ('{"system": "s", "topics": {"/chatter": {"type": "std_msgs/msg/String", "rate": -1}}}\n', _JSON),
        ),
    ),
    "E005": (
        """The key takes one of a few words.""",
        (
            (
                '{"system": "s", "topics": {"/a": {"type": "std_msgs/msg/String", "qos": {"reliability": "sure"}}}}\n',
                _JSON,
            ),
        ),
    ),
    "E006": (
        """What is written cannot be a name in ROS. Names have at most 255 characters.""",
        (('{"system": "my robot"}\n', _JSON),),
    ),
    "E007": (
        """Two things of one kind have one name, so that nobody could say which is meant. Included files share their
        names with the file that includes them.""",
        (
            (_START + _TOPIC + "node talker : Talker { out -> /chatter }\n",),
            (_TALKING + "node talker : Talker\n",),
            (_component("  input a : std_msgs/msg/String\n  input a : std_msgs/msg/Header\n"),),
            (_component("  functionality f {\n    mode a { }\n    mode a { }\n  }\n"),),
            (_component("  parameters { a = 1, a = 2 }\n"),),
            ("system s\nresource memory = 1\nresource memory = 2\n",),
            ("system s\ntiming { create 1 s   create 2 s }\n",),
        ),
    ),
    "E008": (
        """A name is used that is declared nowhere: a contract, topic, component, node, port, functionality, mode,
        resource or parameter. Names that are nearly the same are suggested. Relative names are in the namespace they
        stand in.""",
        (
            (_START + "node talker : Talkr { out -> /chatter }\n",),
            (_START + "node talker : Talker { out -> /chater }\n",),
            (_START + "node talker : Talker { outt -> /chatter }\n",),
            ("system s\ntopic /scan : Scan\n",),
            (_TALKING + "keep talker.talks at normal\n",),
            (_TALKING + "keep talker.talk at norml\n",),
            (_TALKING + "order talkr before talker\n",),
            (_component("  holds memory 5\n"),),
            (
                _component(
                    "  input in : std_msgs/msg/String\n"
                    "  functionality f {\n    uses inn\n    mode a { }\n    mode b { }\n  }\n"
                ),
            ),
            (
                _component(
                    "  input in : std_msgs/msg/String\n"
                    "  functionality f {\n    uses in\n    mode a { assume inn }\n    mode b { }\n  }\n"
                ),
            ),
            (_START + "node talker : Talker { out -> /chatter   parameters { volume = 3 } }\n",),
            ("system s\nenvironment { guarantee camera on /image : sensor_msgs/msg/Image }\n",),
            ("system s\ntiming { creat 1 s }\n",),
            ("system s\ncomponent B like A\n",),
        ),
    ),
    "E009": (
        """A command is split into words as a shell would do it, and run without one. A quote in it is not closed, or
        it has no words.""",
        ((_component('  run "python3 -c \'print(1)"\n'),), (_component('  run ""\n'),)),
    ),
    "E010": (
        """M1 of the semantics: the last mode of a functionality assumes nothing at all. Only so there is always a mode
        that a functionality can be in, whatever else fails.""",
        (("system s\n" + _TOPIC + _LISTENER.replace("mode deaf   { }", "mode deaf   { assume in }"),),),
    ),
    "E011": (
        """M2 of the semantics: whatever a worse mode guarantees, every better mode guarantees as well. Otherwise a
        functionality that recovers could take something away from those that rely on it.""",
        ((_TALKING.replace("mode silent { }", "mode silent { guarantee out : std_msgs/msg/String @ 20 Hz }"),),),
    ),
    "E012": (
        """M3 of the semantics: the guarantees of one output, in all modes, state one type and one QoS, because an
        endpoint has but one. Two types need two outputs.""",
        (
            (_TALKING.replace("mode silent { }", "mode silent { guarantee out : std_msgs/msg/Header @ 1 Hz }"),),
            (
                _TALKING.replace(
                    "mode silent { }",
                    "mode silent { guarantee out : std_msgs/msg/String @ 1 Hz qos(reliability = best_effort) }",
                ),
            ),
        ),
    ),
    "E013": (
        """What an output guarantees is set by the mode of the functionality that produces it. This one is produced by
        none.""",
        ((_component("  output out\n"),),),
    ),
    "E014": (
        """What an output guarantees is set by the mode of the one functionality that produces it. This one has
        several.""",
        (
            (
                _component(
                    "  output out\n"
                    "  functionality a {\n    produces out\n    mode on { }\n    mode off { }\n  }\n"
                    "  functionality b {\n    produces out\n    mode on { }\n    mode off { }\n  }\n"
                ),
            ),
        ),
    ),
    "E015": (
        """A functionality has at least two modes, best first: the normal one, and the degraded one that it falls
        to.""",
        ((_component("  functionality f {\n    mode only { }\n  }\n"),),),
    ),
    "E016": (
        """All constraints on one field together are one set of values, and this one is empty: no message can meet
        it.""",
        (
            ("system s\ncontract Wide = sensor_msgs/msg/Image where width >= 640, width < 320\n",),
            ("system s\ncontract None = sensor_msgs/msg/Image where encoding in {}\n",),
            (
                "system s\ncontract Wide = sensor_msgs/msg/Image where width >= 640\n"
                "contract Slim = Wide where width in [1, 99]\n",
            ),
        ),
    ),
    "E020": (
        """An output can be attached to a topic if what it guarantees in its normal mode satisfies the topic's
        contract; an input if the topic's contract satisfies what the input assumes. The message says clause by clause
        what falls short: the type, the rate, a QoS policy, a field.""",
        (
            (_TALKING.replace("/msg/String @ 10 Hz\ncomponent", "/msg/String @ 20 Hz\ncomponent"),),
            (_PAIR.replace("input in : std_msgs/msg/String @ 5 Hz", "input in : std_msgs/msg/String @ 50 Hz"),),
            (_PAIR.replace("input in : std_msgs/msg/String @ 5 Hz", "input in : std_msgs/msg/Header @ 5 Hz"),),
            (
                _PAIR.replace(
                    "input in : std_msgs/msg/String @ 5 Hz", "input in : std_msgs/msg/String where data = hello"
                ),
            ),
            (
                _PAIR.replace(
                    "input in : std_msgs/msg/String @ 5 Hz",
                    "input in : std_msgs/msg/String qos(durability = transient_local)",
                ),
            ),
        ),
    ),
    "E021": (
        """A port is attached to a topic once or not at all.""",
        ((_START + "node talker : Talker { out -> /chatter, /chatter }\n",),),
    ),
    "E022": (
        """The topic caps its publishers, as an exclusive topic such as a velocity command does. Attached outputs
        count, silent ones too, and so do guarantees of the environment on the topic.""",
        (
            (
                _TALKING.replace("10 Hz\ncomponent", "10 Hz { publishers <= 1 }\ncomponent")
                + "node other : Talker { out -> /chatter }\n",
            ),
        ),
    ),
    "E023": (
        """The nodes hold more of a resource together than there is of it. A device has the capacity 1.""",
        (
            (
                "system s\nresource /dev/video0\ncomponent Camera { holds /dev/video0 }\n"
                "node a : Camera\nnode b : Camera\n",
            ),
            ("system s\nresource memory = 100\ncomponent Big { holds memory 60 }\nnode a : Big\nnode b : Big\n",),
        ),
    ),
    "E024": (
        """No plan could meet these constraints together.""",
        (
            (_PAIR + "order talker before listener\norder listener before talker\n",),
            (_PAIR + "order talker before talker\n",),
        ),
    ),
    "E025": (
        """A node gives a parameter a value of another type than its component's own; ROS 2 would refuse it. A whole
        number serves as a real one.""",
        (
            (
                _START.replace("  output", "  parameters { volume = 0.5 }\n  output")
                + "node talker : Talker { out -> /chatter   parameters { volume = loud } }\n",
            ),
            (
                _START.replace("  output", "  parameters { volume = 0.5 }\n  output")
                + 'node talker : Talker { out -> /chatter   parameters "p.yaml" }\n',
                "example.stride",
                {"p.yaml": "talker:\n  ros__parameters:\n    volume: [0.5]\n"},
            ),
        ),
    ),
    "W030": (
        """A port of this node is attached to no topic: an output that nobody can hear, or an input that is never
        satisfied.""",
        ((_START + "node talker : Talker\n",),),
    ),
    "W031": (
        """No one satisfies the topic: it has no publisher, or the environment's is not good enough. Inputs attached to
        it will not be satisfied.""",
        (
            ("system s\n" + _TOPIC,),
            ("system s\n" + _TOPIC + "environment { guarantee slow on /chatter : std_msgs/msg/String @ 1 Hz }\n",),
        ),
    ),
    "W032": (
        """A mode assumes a predicate that no input of its functionality counts for and the environment does not offer,
        so the functionality can never be in that mode.""",
        (
            (
                _component(
                    "  functionality f {\n"
                    "    mode normal { assume sensor_msgs/msg/Image }\n    mode degraded { }\n  }\n"
                ),
            ),
        ),
    ),
    "W033": (
        """When the system is up, this functionality will not be in its normal mode. The message follows the chain of
        reasons to what falls short.""",
        ((_PAIR.replace("node talker : Talker { out -> /chatter }\n", ""),),),
    ),
    "W034": (
        """A `keep` asks for a mode that the functionality will not be in to begin with.""",
        ((_PAIR.replace("node talker : Talker { out -> /chatter }\n", "") + "keep listener.listen at normal\n",),),
    ),
}
