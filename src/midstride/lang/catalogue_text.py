"""The catalogue of the diagnostics of the text form: files, characters, statements, contracts, names, parameter files
(E100 to E199, W100 to W199).

Each entry consists of the title, the explanation and the arguments of each
:class:`midstride.lang.catalogue.CatalogueExample`.
"""

from __future__ import annotations

from typing import Final, TypeAlias

ExampleParts: TypeAlias = (
    "tuple[str | bytes] | tuple[str | bytes, str] | tuple[str | bytes, str, dict[str, str | bytes]]"
)

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

TEXT: Final[dict[str, tuple[str, str, tuple[ExampleParts, ...]]]] = {
    # -- files -----------------------------------------------------------------------------------------
    "E100": (
        "file cannot be read",
        """The file does not exist, cannot be read or is not a regular file. Paths of includes and parameter files
        are relative to the file that names them.""",
        (
            ('system s\ninclude "missing.stride"\n',),
            ('system s\nparameters "missing.yaml"\n' + _TALKING.removeprefix("system s\n"),),
            ('system s\ninclude ""\n',),
        ),
    ),
    "E101": (
        "file is not UTF-8",
        """Files are encoded in UTF-8, with or without a byte order mark. The message gives the position of the first
        invalid byte.""",
        (
            (b"system caf\xe9\n",),
            ("system s\n".encode("utf-16"),),
            ('system s\ninclude "latin.stride"\n', "example.stride", {"latin.stride": b"# caf\xe9\n"}),
        ),
    ),
    "E102": (
        "file too large",
        """Files are limited to four megabytes, far more than a hand-written specification needs. This is probably
        the wrong file.""",
        (("system s\n" + "# padding\n" * 420_000,),),
    ),
    "E103": (
        "include cycle",
        """Files include each other in a cycle. The message lists the files of the cycle in order.""",
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
        "include limit exceeded",
        """The number of files, their total size and the depth of includes are limited, so that loading ends even if
        a file includes itself under many names.""",
        (('system s\ninclude "part0.stride"\n', "example.stride", dict(_MANY)),),
    ),
    "E105": (
        "included file is a system",
        """An included file is a fragment: it has no `system` line, because the file that includes it names the
        system.""",
        (('system s\ninclude "other.stride"\n', "example.stride", {"other.stride": "system other\n"}),),
    ),
    "E106": (
        "no system name",
        """The file to check, launch or plan for starts with `system NAME`. A fragment has no such line; check the
        file that includes it, because a fragment alone may lack declarations.""",
        (("topic /chatter : std_msgs/msg/String\n",), ("",)),
    ),
    # -- characters -----------------------------------------------------------------------------------------
    "E110": (
        "unexpected character",
        """The character is not part of the language. Names consist of ASCII letters, digits and underscores, joined
        by slashes, as in ROS. Put a device path with other characters in double quotes.""",
        (
            ("system s\ntopic /chatter : std_msgs/msg/String;\n",),
            ("system s\ntopic /scän : std_msgs/msg/String\n",),
            ("system s\nresource /dev/ttyUSB-0\n",),
            ("system s\n// a comment\n",),
        ),
    ),
    "E111": (
        "invalid name",
        """A part of the name is empty or starts with a digit, or the name has more than 255 characters.""",
        (
            ("system s\ntopic /front//scan : std_msgs/msg/String\n",),
            ("system s\ntopic /scan/ : std_msgs/msg/String\n",),
        ),
    ),
    "E112": (
        "string in single quotes",
        """Strings use double quotes. They can contain single quotes, as in a command.""",
        ((_CHATTER.replace("  output out\n", "  run 'python3 -m talker'\n  output out\n") + _NODE,),),
    ),
    "E113": (
        "unterminated or too long string",
        """A string ends on the line on which it starts, and has at most 8192 characters.""",
        ((_CHATTER.replace("  output out\n", '  run "python3 -m talker\n  output out\n') + _NODE,),),
    ),
    "E114": (
        "unknown escape sequence",
        r"""In a string, `\"` is a double quote, `\\` a backslash, `\n` a new line and `\t` a tab. There are no other
        escape sequences.""",
        ((_CHATTER.replace("  output out\n", '  run "python3 -m talker \\d"\n  output out\n') + _NODE,),),
    ),
    "E115": (
        "NUL byte",
        """A text file contains no NUL bytes: this is probably a binary file, or one in UTF-16 or UTF-32.""",
        (("system s\n\0\n",),),
    ),
    # -- statements ------------------------------------------------------------------------------------
    "E120": (
        "syntax error",
        """The language requires something else at this place. The statement is skipped, and parsing continues with
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
        "unknown statement",
        """No statement that is allowed here starts with this word. It resembles a keyword and was parsed as that.""",
        (
            ("system s\ntopik /chatter : std_msgs/msg/String @ 10 Hz\n" + TALKER + _NODE,),
            (_CHATTER.replace("produces", "produce") + _NODE,),
        ),
    ),
    "E122": (
        "statement in the wrong block",
        """This statement belongs in another block, which the message names.""",
        ((_CHATTER.replace("  output out\n", "  output out\n  assume out\n") + _NODE,),),
    ),
    "E123": (
        "block not closed",
        """The closing brace of the block is missing: a statement of an outer block follows, or the file ends.""",
        (
            (_CHATTER.replace("10 Hz }\n    mode silent", "10 Hz\n    mode silent") + _NODE,),
            ("system s\ncomponent Talker {\n  output out\n",),
        ),
    ),
    "E124": (
        "unmatched closing brace",
        """There are more closing braces than open blocks.""",
        ((_TALKING + "}\n",),),
    ),
    "E125": (
        "keyword used as a name",
        """The keywords that start statements cannot be names: lists need no comma, so the next statement would look
        like the next name.""",
        ((_CHATTER + "component Filter {\n  input input : std_msgs/msg/String\n}\n" + _NODE,),),
    ),
    "E126": (
        "number out of range",
        """Rates must be greater than 0, and the number of publishers must be whole. Numbers are at most 1e18, and
        integer parameters have at most 64 bits.""",
        (
            ("system s\ntopic /chatter : std_msgs/msg/String @ 0 Hz\n" + TALKER + _NODE,),
            (_TALKING + "resource memory = 1e999\n",),
            ("system s\ntopic /chatter : std_msgs/msg/String { publishers <= 1.5 }\n" + TALKER + _NODE,),
            (_CHATTER.replace("  output", "  parameters { seed = 9999999999999999999 }\n  output") + _NODE,),
        ),
    ),
    "E127": (
        "missing or unknown unit",
        """Rates need the unit `Hz` or `kHz`; times need `s`, `ms`, `us` or `min`.""",
        (
            ("system s\ntopic /chatter : std_msgs/msg/String @ 10\n" + TALKER + _NODE,),
            ("system s\ntopic /chatter : std_msgs/msg/String @ 10 hz\n" + TALKER + _NODE,),
            (_TALKING + "limit talker.talk below baseline 2\n",),
            ("system s\ntopic /chatter : std_msgs/msg/String qos(deadline = 1)\n",),
            ("system s\ntopic /chatter : std_msgs/msg/String qos(deadline = 1 parsec)\n",),
        ),
    ),
    "E128": (
        "stated more than once",
        """Something that can be stated only once is stated again.""",
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
        "namespaces nested too deep",
        """Namespaces are nested deeper than any hand-written file needs. A namespace can combine several names:
        `namespace a/b`.""",
        (("system s\n" + "namespace n { " * 20 + "} " * 20 + "\n",),),
    ),
    # -- contracts -------------------------------------------------------------------------------------
    "E130": (
        "unknown message type",
        """The package of the type is installed, but has no such message type. Types of packages that are not
        installed are not checked.""",
        (("system s\ncontract Scan = sensor_msgs/msg/LaserScam @ 10 Hz\n",),),
    ),
    "E131": (
        "unknown QoS policy or value",
        """QoS policies have the names used by ROS 2: reliability (reliable, best_effort), durability (volatile,
        transient_local), history (keep_last, keep_all), depth, deadline, lifespan, liveliness (automatic,
        manual_by_topic) and lease.""",
        (
            ("system s\ncontract Scan = sensor_msgs/msg/LaserScan qos(reliabilty = best_effort)\n",),
            ("system s\ncontract Scan = sensor_msgs/msg/LaserScan qos(reliability = best_efort)\n",),
            ("system s\ncontract Scan = sensor_msgs/msg/LaserScan qos(depth = many)\n",),
            ("system s\ncontract Scan = sensor_msgs/msg/LaserScan qos(deadline = soon)\n",),
        ),
    ),
    "E132": (
        "invalid comparison",
        """Field constraints use `=`, `<`, `<=`, `>`, `>=` and `in`; all except `=` and `in {…}` compare numbers.""",
        (
            ("system s\ncontract Wide = sensor_msgs/msg/Image where width == 640\n",),
            ("system s\ncontract Wide = sensor_msgs/msg/Image where encoding != rgb8\n",),
            ("system s\ncontract Wide = sensor_msgs/msg/Image where encoding > rgb8\n",),
        ),
    ),
    "E133": (
        "not a message type",
        """A message type is written `pkg/msg/Type` as in ROS 2 or `pkg/Type` as in ROS 1.""",
        (
            ("system s\ncontract Scan = sensor_msgs/srv/msg/LaserScan\n",),
            ("system s\ncontract Scan = sensor_msgs.msg.LaserScan\n",),
            ("system s\ncontract Scan = sensor_msgs::msg::LaserScan\n",),
        ),
    ),
    "E134": (
        "list with mixed types",
        """List parameters in ROS contain only numbers, only strings or only booleans.""",
        ((_CHATTER.replace("  output", '  parameters { names = ["a", 1] }\n  output') + _NODE,),),
    ),
    "E135": (
        "`nothing` where a contract is required",
        """`nothing` states that an output produces nothing in a mode. It satisfies no assumption, so it can be
        neither assumed nor the contract of a topic; and it has no rate, QoS or fields.""",
        (
            ("system s\ntopic /chatter : nothing\n",),
            (_CHATTER.replace("mode silent { }", "mode silent { guarantee out : nothing @ 1 Hz }") + _NODE,),
            ("system s\ncontract None = nothing\ncontract Less = None where data = 1\n",),
        ),
    ),
    "E136": (
        "cycle of contracts",
        """A contract can refine another one, but the chain must end at a message type.""",
        (("system s\ncontract A = B @ 5 Hz\ncontract B = A @ 6 Hz\n",),),
    ),
    "E137": (
        "unknown field",
        """The message type is installed, but has no such field.""",
        (
            ("system s\ncontract Wide = sensor_msgs/msg/Image where widht >= 640\n",),
            ("system s\ncontract Wide = sensor_msgs/msg/Image where width.x >= 640\n",),
        ),
    ),
    "E138": (
        "comparison with the wrong type",
        """The comparison does not match the type of the field (number, string or boolean), or the field is a list or
        a message, which cannot be compared.""",
        (
            ("system s\ncontract Wide = sensor_msgs/msg/Image where width = wide\n",),
            ("system s\ncontract Wide = sensor_msgs/msg/Image where data = 1\n",),
        ),
    ),
    # -- names -----------------------------------------------------------------------------------------
    "E139": (
        "private topic outside a node",
        """`~/name` is private to a node. Declare the topic by its full name: `/node/name`.""",
        (("system s\ntopic ~/chatter : std_msgs/msg/String\n",),),
    ),
    "E140": (
        "cycle of components",
        """A component can be like another one, but the chain must end, after at most 32 steps, at a component
        without `like`.""",
        (
            ("system s\ncomponent A like B\ncomponent B like A\n",),
            ("system s\ncomponent C0 { }\n" + "".join(f"component C{n + 1} like C{n}\n" for n in range(40)),),
        ),
    ),
    "E141": (
        "name of both a contract and an input",
        """A contract and an input have the same name, so `assume NAME` is ambiguous: it could mean this input, or
        any input that satisfies the contract.""",
        (
            (
                "system s\ncontract scan = sensor_msgs/msg/LaserScan\n"
                "component C {\n  input scan : sensor_msgs/msg/LaserScan\n}\n",
            ),
        ),
    ),
    "E142": (
        "refined assumption on an input",
        """`assume scan` relies on the input with the assumption from its declaration, which a mode cannot refine. An
        assumed contract can be refined.""",
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
        """Whether a parameter can be changed in place depends on the program, so it is declared in the component. A
        node only sets values.""",
        (
            (
                _CHATTER.replace("  output", "  parameters { volume = 1 }\n  output")
                + "node talker : Talker { out -> /chatter   parameters { changeable volume = 2 } }\n",
            ),
        ),
    ),
    "E144": (
        "arrow in the wrong direction",
        """The arrow points in the direction of the messages: `input <- /topic` and `output -> /topic`.""",
        ((_CHATTER + "node talker : Talker { out <- /chatter }\n",),),
    ),
    "E145": (
        "too many entries",
        """A declaration has more entries of one kind than any hand-written file, such as a component with over a
        thousand ports. The rest are not checked.""",
        (("system s\nenvironment {\n" + "".join(f"guarantee g{n} : a/B\n" for n in range(1001)) + "}\n",),),
    ),
    # -- parameter files -------------------------------------------------------------------------------
    "E150": (
        "invalid ROS parameter file",
        """A parameter file is YAML: a section per node, named as in ROS (with its namespace, or with wildcards),
        each with `ros__parameters`, whose values are strings, numbers, booleans and lists of them.""",
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
        "parameter set for only some nodes",
        """A parameter file sets a parameter for one node of a component but not for another, and the component
        declares no value for it: the value for the other node is undefined.""",
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
        """There are too many errors to show all of them. One of the first errors may be the cause of the rest, or
        the file may be in another language.""",
        (("system s\n" + "wibble\n;\n" * 120,),),
    ),
    "W160": (
        "parameter file without a section for the node",
        """The node names a parameter file, but no section of that file applies to the node.""",
        (
            (
                _CHATTER + 'node talker : Talker { out -> /chatter   parameters "p.yaml" }\n',
                "example.stride",
                {"p.yaml": "talkr:\n  ros__parameters:\n    volume: 3\n"},
            ),
        ),
    ),
}
