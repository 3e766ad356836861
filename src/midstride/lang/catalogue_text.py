"""The part of the catalogue that is about texts: files, signs, statements, names and types (E100 to E199, W100 to
W199).

Each entry: the title, the explanation, and the examples, whose parts are those of
:class:`midstride.lang.catalogue.Example`.
"""

from __future__ import annotations

from typing import Final, TypeAlias

Parts: TypeAlias = "tuple[str | bytes] | tuple[str | bytes, str] | tuple[str | bytes, str, dict[str, str | bytes]]"

TALKER: Final = """component Talker {
  output out
  functionality talk {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 10 Hz }
    mode silent { }
  }
}
"""
_CHATTER: Final = "system s\ntopic /chatter : std_msgs/msg/String @ 10 Hz\n" + TALKER
_NODE: Final = "node talker : Talker { out -> /chatter }\n"
_TALKING: Final = _CHATTER + _NODE
_MANY: Final = {f"part{n}.stride": f'include "part{n + 1}.stride"\n' for n in range(40)}

TEXT: Final[dict[str, tuple[str, str, tuple[Parts, ...]]]] = {
    # -- files -----------------------------------------------------------------------------------------
    "E100": (
        "a file cannot be read",
        """The file named here is not there, may not be read, or is no regular file. Includes and parameter files are
        relative to the file that names them.""",
        (
            ('system s\ninclude "missing.stride"\n',),
            ('system s\nparameters "missing.yaml"\n' + _TALKING.removeprefix("system s\n"),),
            ('system s\ninclude ""\n',),
        ),
    ),
    "E101": (
        "a file is not in UTF-8",
        """Files are UTF-8, with or without a byte order mark. The message names the first byte that is none.""",
        (
            (b"system caf\xe9\n",),
            ("system s\n".encode("utf-16"),),
            ('system s\ninclude "latin.stride"\n', "example.stride", {"latin.stride": b"# caf\xe9\n"}),
        ),
    ),
    "E102": (
        "a file is too large",
        """No specification that people wrote is larger than four megabytes: this is most likely another file.""",
        (("system s\n" + "# padding\n" * 420_000,),),
    ),
    "E103": (
        "files include each other",
        """A cycle of includes has no end. The message names the files of the cycle in order.""",
        (
            ('system s\ninclude "example.stride"\n',),
            (
                'system s\ninclude "a.stride"\n',
                "example.stride",
                {"a.stride": 'include "b.stride"\n', "b.stride": 'include "a.stride"\n'},
            ),
        ),
    ),
    "E104": (
        "too much is included",
        """How many files are read, how deep they include each other, and how large they are together is bounded, so
        that a file that includes itself under many names ends in this error.""",
        (('system s\ninclude "part0.stride"\n', "example.stride", dict(_MANY)),),
    ),
    "E105": (
        "a system is included",
        """An included file is a fragment: it has no `system` line, since the file that includes it names the
        system.""",
        (('system s\ninclude "other.stride"\n', "example.stride", {"other.stride": "system other\n"}),),
    ),
    "E106": (
        "no system is named",
        """The file that is checked, launched or planned for begins with `system NAME`. A fragment, which has no such
        line, is checked by checking the file that includes it: alone it may lack what others declare.""",
        (("topic /chatter : std_msgs/msg/String\n",), ("",)),
    ),
    # -- signs -----------------------------------------------------------------------------------------
    "E110": (
        "a character that means nothing here",
        """The character belongs to no name, number, text or sign of the language. Names are as in ROS: ASCII letters,
        digits and underscores, joined by slashes. A device whose path has other characters stands in double quotes.""",
        (
            ("system s\ntopic /chatter : std_msgs/msg/String;\n",),
            ("system s\ntopic /scän : std_msgs/msg/String\n",),
            ("system s\nresource /dev/ttyUSB-0\n",),
            ("system s\n// a comment\n",),
        ),
    ),
    "E111": (
        "no name as ROS has them",
        """A part of the name is empty or begins with a digit, or the whole has more than 255 characters.""",
        (
            ("system s\ntopic /front//scan : std_msgs/msg/String\n",),
            ("system s\ntopic /scan/ : std_msgs/msg/String\n",),
        ),
    ),
    "E112": (
        "a text in single quotes",
        """Texts stand in double quotes. Single quotes may stand in them, as in a command.""",
        ((_CHATTER.replace("  output out\n", "  run 'python3 -m talker'\n  output out\n") + _NODE,),),
    ),
    "E113": (
        "a text is not closed, or too long",
        """A text ends on the line it begins on, and has at most 8192 characters.""",
        ((_CHATTER.replace("  output out\n", '  run "python3 -m talker\n  output out\n') + _NODE,),),
    ),
    "E114": (
        "an escape that stands for nothing",
        r"""In a text `\"` stands for a double quote, `\\` for a backslash, `\n` for a new line and `\t` for a tab.""",
        ((_CHATTER.replace("  output out\n", '  run "python3 -m talker \\d"\n  output out\n') + _NODE,),),
    ),
    "E115": (
        "a NUL byte",
        """No text has NUL bytes: this is most likely a binary file, or one in UTF-16 or UTF-32.""",
        (("system s\n\0\n",),),
    ),
    # -- statements ------------------------------------------------------------------------------------
    "E120": (
        "something else is expected",
        """At the place shown the language expects something else. The statement is left out, and reading goes on with
        the next one.""",
        (
            ("system s\ntopic /chatter std_msgs/msg/String\n",),
            ("system s\ncontract Scan = @ 10 Hz\n",),
            ("system s\ntopic /chatter : std_msgs/msg/String 10 Hz\n",),
            ('system s\ntopic /a : std_msgs/msg/String where data in {"a", "b"\ntopic /b : std_msgs/msg/String\n',),
            (_CHATTER + "node talker : Talker { out /chatter }\n",),
            (_CHATTER.replace("output out", "output out : std_msgs/msg/String") + _NODE,),
            (_CHATTER.replace("output out", "allows action ~/dock\n  output out") + _NODE,),
            ("system s\ninclude sensors.stride\n",),
            ("system s\nenvironment { guarantee camera on : std_msgs/msg/String }\n",),
            (_TALKING + "keep talker.talk normal\n",),
            (_TALKING + "timing { create = 1 s }\n",),
            (_TALKING + "wibble wobble\n",),
        ),
    ),
    "E121": (
        "an unknown statement",
        """The word begins no statement that may stand here, but resembles one that does, and was read as that one.""",
        (
            ("system s\ntopik /chatter : std_msgs/msg/String @ 10 Hz\n" + TALKER + _NODE,),
            (_CHATTER.replace("produces", "produce") + _NODE,),
        ),
    ),
    "E122": (
        "a statement in the wrong block",
        """The word begins a statement, but of another block. The message says which.""",
        ((_CHATTER.replace("  output out\n", "  output out\n  assume out\n") + _NODE,),),
    ),
    "E123": (
        "a block is not closed",
        """The block ends before its closing brace: a statement of an outer block begins, or the file ends.""",
        (
            (_CHATTER.replace("10 Hz }\n    mode silent", "10 Hz\n    mode silent") + _NODE,),
            ("system s\ncomponent Talker {\n  output out\n",),
        ),
    ),
    "E124": (
        "a brace that closes nothing",
        """There is one closing brace more than there are blocks to close.""",
        ((_TALKING + "}\n",),),
    ),
    "E125": (
        "a word of the language as a name",
        """The words that begin statements cannot be names: lists need no comma, so the next statement would look like
        the next name.""",
        ((_CHATTER + "component Filter {\n  input input : std_msgs/msg/String\n}\n" + _NODE,),),
    ),
    "E126": (
        "a number out of range",
        """Rates are more than 0, numbers of publishers whole. Numbers are at most 1e18, and whole numbers given to
        parameters have at most 64 bits.""",
        (
            ("system s\ntopic /chatter : std_msgs/msg/String @ 0 Hz\n" + TALKER + _NODE,),
            (_TALKING + "resource memory = 1e999\n",),
            ("system s\ntopic /chatter : std_msgs/msg/String { publishers <= 1.5 }\n" + TALKER + _NODE,),
            (_CHATTER.replace("  output", "  parameters { seed = 9999999999999999999 }\n  output") + _NODE,),
        ),
    ),
    "E127": (
        "a unit is missing or unknown",
        """Rates are in `Hz` or `kHz`; times in `s`, `ms`, `us` or `min`.""",
        (
            ("system s\ntopic /chatter : std_msgs/msg/String @ 10\n" + TALKER + _NODE,),
            ("system s\ntopic /chatter : std_msgs/msg/String @ 10 hz\n" + TALKER + _NODE,),
            (_TALKING + "limit talker.talk below baseline 2\n",),
            ("system s\ntopic /chatter : std_msgs/msg/String qos(deadline = 1)\n",),
            ("system s\ntopic /chatter : std_msgs/msg/String qos(deadline = 1 parsec)\n",),
        ),
    ),
    "E128": (
        "stated twice",
        """Something that can be stated once only is stated a second time.""",
        (
            ("system s\nsystem t\n",),
            ("system s\ncontract Scan = sensor_msgs/msg/LaserScan @ 10 Hz @ 20 Hz\n",),
            ("system s\ncontract Scan = sensor_msgs/msg/LaserScan qos(depth = 1) qos(depth = 2)\n",),
            ("system s\ncontract Scan = sensor_msgs/msg/LaserScan qos(depth = 1, depth = 2)\n",),
            (_CHATTER.replace("  output", '  run "a"\n  run "b"\n  output') + _NODE,),
            (
                "system s\ntopic /chatter : std_msgs/msg/String { publishers <= 1   publishers <= 2 }\n"
                + TALKER
                + _NODE,
            ),
        ),
    ),
    "E129": (
        "namespaces are nested too deep",
        """Nobody writes this many namespaces in each other by hand. Several names make one namespace: `namespace
        a/b`.""",
        (("system s\n" + "namespace n { " * 20 + "} " * 20 + "\n",),),
    ),
    # -- contracts -------------------------------------------------------------------------------------
    "E130": (
        "an unknown message type",
        """The package of the type is installed here and has no such message type. Types of packages that are not
        installed are not checked.""",
        (("system s\ncontract Scan = sensor_msgs/msg/LaserScam @ 10 Hz\n",),),
    ),
    "E131": (
        "an unknown QoS policy or value",
        """QoS profiles use ROS 2's names: reliability (reliable, best_effort), durability (volatile, transient_local),
        history (keep_last, keep_all), depth, deadline, lifespan, liveliness (automatic, manual_by_topic) and lease.""",
        (
            ("system s\ncontract Scan = sensor_msgs/msg/LaserScan qos(reliabilty = best_effort)\n",),
            ("system s\ncontract Scan = sensor_msgs/msg/LaserScan qos(reliability = best_efort)\n",),
            ("system s\ncontract Scan = sensor_msgs/msg/LaserScan qos(depth = many)\n",),
            ("system s\ncontract Scan = sensor_msgs/msg/LaserScan qos(deadline = soon)\n",),
        ),
    ),
    "E132": (
        "a comparison that cannot be made",
        """Fields are constrained by `=`, `<`, `<=`, `>`, `>=` and `in`; all but `=` and `in {…}` compare numbers.""",
        (
            ("system s\ncontract Wide = sensor_msgs/msg/Image where width == 640\n",),
            ("system s\ncontract Wide = sensor_msgs/msg/Image where encoding != rgb8\n",),
            ("system s\ncontract Wide = sensor_msgs/msg/Image where encoding > rgb8\n",),
        ),
    ),
    "E133": (
        "no message type",
        """A message type is written `pkg/msg/Type` as in ROS 2 or `pkg/Type` as in ROS 1.""",
        (
            ("system s\ncontract Scan = sensor_msgs/srv/msg/LaserScan\n",),
            ("system s\ncontract Scan = sensor_msgs.msg.LaserScan\n",),
            ("system s\ncontract Scan = sensor_msgs::msg::LaserScan\n",),
        ),
    ),
    "E134": (
        "a list of several kinds",
        """ROS parameters are lists of numbers, of texts, or of true and false.""",
        ((_CHATTER.replace("  output", '  parameters { names = ["a", 1] }\n  output') + _NODE,),),
    ),
    "E135": (
        "`nothing` where something is needed",
        """`nothing` says that an output produces nothing in a mode. It satisfies no assumption, so no one can assume
        it and no topic can carry it; and it has no rate, QoS or fields.""",
        (
            ("system s\ntopic /chatter : nothing\n",),
            (_CHATTER.replace("mode silent { }", "mode silent { guarantee out : nothing @ 1 Hz }") + _NODE,),
            ("system s\ncontract None = nothing\ncontract Less = None where data = 1\n",),
        ),
    ),
    "E136": (
        "contracts are defined by each other",
        """A contract may refine another one, but in the end one of them names a message type.""",
        (("system s\ncontract A = B @ 5 Hz\ncontract B = A @ 6 Hz\n",),),
    ),
    "E137": (
        "an unknown field",
        """The message type is installed here and has no such field.""",
        (
            ("system s\ncontract Wide = sensor_msgs/msg/Image where widht >= 640\n",),
            ("system s\ncontract Wide = sensor_msgs/msg/Image where width.x >= 640\n",),
        ),
    ),
    "E138": (
        "a field of another kind",
        """The field is no number, no text, or no truth value, as the comparison would need it; or it is a list or a
        message, which has no one value.""",
        (
            ("system s\ncontract Wide = sensor_msgs/msg/Image where width = wide\n",),
            ("system s\ncontract Wide = sensor_msgs/msg/Image where data = 1\n",),
        ),
    ),
    # -- names -----------------------------------------------------------------------------------------
    "E139": (
        "a private topic of no node",
        """`~/name` is private to a node. A topic is declared by its full name: `/node/name`.""",
        (("system s\ntopic ~/chatter : std_msgs/msg/String\n",),),
    ),
    "E140": (
        "components are like each other",
        """A component may be like another one, but in the end, and before long, one of them is declared by itself.""",
        (
            ("system s\ncomponent A like B\ncomponent B like A\n",),
            ("system s\ncomponent C0 { }\n" + "".join(f"component C{n + 1} like C{n}\n" for n in range(40)),),
        ),
    ),
    "E141": (
        "a name for two things",
        """A contract and an input have the same name, so `assume NAME` could mean either: this input, or any input that
        is good enough.""",
        (
            (
                "system s\ncontract scan = sensor_msgs/msg/LaserScan\n"
                "component C {\n  input scan : sensor_msgs/msg/LaserScan\n}\n",
            ),
        ),
    ),
    "E142": (
        "an assumption on an input, refined",
        """`assume scan` relies on the input for what the input itself assumes. More cannot be asked of it in one mode
        alone; a contract can be assumed with more.""",
        (
            (
                "system s\ncomponent C {\n  input scan : sensor_msgs/msg/LaserScan\n"
                "  functionality f {\n    uses scan\n"
                "    mode normal { assume scan @ 5 Hz }\n    mode degraded { }\n  }\n}\n",
            ),
        ),
    ),
    "E143": (
        "`changeable` in a node",
        """Whether a parameter can be set in place depends on the program, so the component says it. A node gives
        values.""",
        (
            (
                _CHATTER.replace("  output", "  parameters { volume = 1 }\n  output")
                + "node talker : Talker { out -> /chatter   parameters { changeable volume = 2 } }\n",
            ),
        ),
    ),
    "E144": (
        "an arrow the wrong way round",
        """`input <- /topic` and `output -> /topic`: the arrow points the way that messages go.""",
        ((_CHATTER + "node talker : Talker { out <- /chatter }\n",),),
    ),
    "E145": (
        "too many parts",
        """A declaration has more parts of one kind than anyone writes: a component a thousand ports, say. Only so many
        are looked at.""",
        (("system s\nenvironment {\n" + "".join(f"guarantee g{n} : a/B\n" for n in range(1001)) + "}\n",),),
    ),
    # -- parameter files -------------------------------------------------------------------------------
    "E150": (
        "no ROS parameter file",
        """A parameter file is YAML: a section for each node, named as in ROS (with its namespace, or with wildcards),
        and in each `ros__parameters` with texts, numbers, truth values and lists of them.""",
        (
            (_TALKING + 'parameters "p.yaml"\n', "example.stride", {"p.yaml": "talker:\n  volume: 3\n"}),
            (
                _TALKING + 'parameters "p.yaml"\n',
                "example.stride",
                {"p.yaml": "talker:\n  ros__parameters:\n    volume: [a, 1]\n"},
            ),
            (_TALKING + 'parameters "p.yaml"\n', "example.stride", {"p.yaml": "talker: [\n"}),
            (
                _TALKING + 'parameters "p.yaml"\n',
                "example.stride",
                {"p.yaml": "talker:\n  ros__parameters:\n    volume:\n"},
            ),
            (_TALKING + 'parameters "p.yaml"\n', "example.stride", {"p.yaml": "[" * 50}),
        ),
    ),
    "E151": (
        "a parameter that only some nodes are given",
        """A parameter file gives a parameter to one node of a component and not to another one, and the component
        declares no value for it: what the other node is to run with is not said anywhere.""",
        (
            (
                "system s\ntopic /chatter : std_msgs/msg/String\n"
                + TALKER
                + 'node a : Talker { out -> /chatter }\nnode b : Talker { out -> /chatter }\nparameters "p.yaml"\n',
                "example.stride",
                {"p.yaml": "a:\n  ros__parameters:\n    volume: 3\n"},
            ),
        ),
    ),
    "E199": (
        "too many errors",
        """So much is wrong that the rest is not shown: one of the first errors may explain it, or the text is in
        another language.""",
        (("system s\n" + "wibble\n;\n" * 120,),),
    ),
    "W160": (
        "a parameter file without a section for the node",
        """The node names a parameter file, and no section of it is for this node.""",
        (
            (
                _CHATTER + 'node talker : Talker { out -> /chatter   parameters "p.yaml" }\n',
                "example.stride",
                {"p.yaml": "talkr:\n  ros__parameters:\n    volume: 3\n"},
            ),
        ),
    ),
}
