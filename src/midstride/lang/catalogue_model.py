"""The catalogue of the model's diagnostics (E001 to E099, W001 to W099): explanations and examples.

Titles and advice are in :mod:`midstride.model.diagnostics`. Each entry consists of the explanation and the arguments of
each :class:`midstride.lang.catalogue.CatalogueExample`. Codes specific to JSON have examples in JSON.
"""

from __future__ import annotations

from typing import Final

from midstride.lang.catalogue_syntax import TALKER, ExampleParts

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


MODEL: Final[dict[str, tuple[str, tuple[ExampleParts, ...]]]] = {
    "E001": (
        """A value in the JSON form does not have the type that its key requires, or the file is not valid JSON.""",
        (('{"system": 5}\n', _JSON), ('{"system": "s"\n', _JSON), ('{"system": "s", "nodes": []}\n', _JSON)),
    ),
    "E002": (
        """The JSON form has no such key here. A similar key is suggested if there is one.""",
        (('{"system": "s", "topic": {}}\n', _JSON),),
    ),
    "E003": ("""A key that the JSON form requires is missing.""", (("{}\n", _JSON),)),
    "E004": (
        """The number is not finite or is out of range: rates and capacities must be greater than 0; times and
        weights cannot be negative.""",
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
        """The key accepts only certain values.""",
        (
            (
                '{"system": "s", "topics": {"/a": {"type": "std_msgs/msg/String", "qos": {"reliability": "sure"}}}}\n',
                _JSON,
            ),
        ),
    ),
    "E006": (
        """This is not a valid name in ROS. Names have at most 255 characters.""",
        (('{"system": "my robot"}\n', _JSON),),
    ),
    "E007": (
        """Two declarations of the same kind have the same name, so references to it are ambiguous. Included files
        share one set of names with the file that includes them.""",
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
        """The name of a contract, topic, component, node, port, functionality, mode, resource or parameter is not
        declared anywhere. A similar name is suggested if there is one. Relative names are resolved in the enclosing
        namespace.""",
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
        """A command is split into words as in a shell, but run without one. Here a quote is not closed, or the
        command is empty.""",
        ((_component('  run "python3 -c \'print(1)"\n'),), (_component('  run ""\n'),)),
    ),
    "E010": (
        """Rule M1 of the semantics: the last mode of a functionality assumes nothing. This guarantees that each
        functionality always has a mode it can be in, whatever fails.""",
        (("system s\n" + _TOPIC + _LISTENER.replace("mode deaf   { }", "mode deaf   { assume in }"),),),
    ),
    "E011": (
        """Rule M2 of the semantics: a better mode guarantees everything that a worse mode guarantees. Otherwise a
        functionality that recovers could withdraw a guarantee that others depend on.""",
        ((_TALKING.replace("mode silent { }", "mode silent { guarantee out : std_msgs/msg/String @ 20 Hz }"),),),
    ),
    "E012": (
        """Rule M3 of the semantics: the guarantees of one output state the same type and QoS in all modes, because
        the output is a single endpoint. Use two outputs for two types.""",
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
        """The guarantee of an output depends on the mode of the functionality that produces it. No functionality
        produces this one.""",
        ((_component("  output out\n"),),),
    ),
    "E014": (
        """The guarantee of an output depends on the mode of the one functionality that produces it. Several
        functionalities produce this one.""",
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
        """A functionality has at least two modes, best first: the normal mode, and the degraded mode that it falls
        back to.""",
        ((_component("  functionality f {\n    mode only { }\n  }\n"),),),
    ),
    "E016": (
        """The constraints on a field together define a set of values, and this set is empty: no message satisfies
        them.""",
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
        """An output can be attached to a topic if the guarantee of its normal mode satisfies the contract of the
        topic; an input can be attached if the contract of the topic satisfies the assumption of the input. The
        message lists each mismatch: type, rate, QoS policy or field.""",
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
        """A port can be attached to a topic only once.""",
        ((_START + "node talker : Talker { out -> /chatter, /chatter }\n",),),
    ),
    "E022": (
        """The topic limits the number of its publishers, as a velocity command does, for example. All attached
        outputs count, including silent ones, as do environment guarantees on the topic.""",
        (
            (
                _TALKING.replace("10 Hz\ncomponent", "10 Hz { publishers <= 1 }\ncomponent")
                + "node other : Talker { out -> /chatter }\n",
            ),
        ),
    ),
    "E023": (
        """Together the nodes use more of a resource than its capacity. A device has capacity 1.""",
        (
            (
                "system s\nresource /dev/video0\ncomponent Camera { holds /dev/video0 }\n"
                "node a : Camera\nnode b : Camera\n",
            ),
            ("system s\nresource memory = 100\ncomponent Big { holds memory 60 }\nnode a : Big\nnode b : Big\n",),
        ),
    ),
    "E024": (
        """No plan can satisfy these constraints together.""",
        (
            (_PAIR + "order talker before listener\norder listener before talker\n",),
            (_PAIR + "order talker before talker\n",),
        ),
    ),
    "E025": (
        """A node sets a parameter to a value of a different type than its component declares, which ROS 2 would
        reject. An integer is accepted for a floating-point parameter.""",
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
        """A port of this node is not attached to any topic: an output without subscribers, or an input that is never
        satisfied.""",
        ((_START + "node talker : Talker\n",),),
    ),
    "W031": (
        """Nothing satisfies the contract of the topic: it has no publisher, or the environment guarantees too
        little. Inputs attached to it will not be satisfied.""",
        (
            ("system s\n" + _TOPIC,),
            ("system s\n" + _TOPIC + "environment { guarantee slow on /chatter : std_msgs/msg/String @ 1 Hz }\n",),
        ),
    ),
    "W032": (
        """A mode assumes a predicate that neither an input of its functionality nor the environment can satisfy, so
        the functionality can never be in that mode.""",
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
        """When the system starts, this functionality will not be in its normal mode. The message follows the chain
        of reasons to the root cause.""",
        ((_PAIR.replace("node talker : Talker { out -> /chatter }\n", ""),),),
    ),
    "W034": (
        """A `keep` constraint requires a mode that the functionality will not be in when the system starts.""",
        ((_PAIR.replace("node talker : Talker { out -> /chatter }\n", "") + "keep listener.listen at normal\n",),),
    ),
}
