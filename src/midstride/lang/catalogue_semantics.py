"""The catalogue of errors in the meaning of a text: contracts, names and parameter files (E130 to E198, W100 on)."""

from __future__ import annotations

from typing import Final

from midstride.lang.catalogue_entry import CHATTER, NODE, TALKER, TALKING, CatalogueExample, entry, respawning

SEMANTICS: Final = (
    # -- contracts -------------------------------------------------------------------------------------
    entry(
        "E130: unknown message type",
        """The package of the type is installed, but has no such message type. Types of packages that are not
        installed are not checked.""",
        "system s\ncontract Scan = sensor_msgs/msg/LaserScam @ 10 Hz\n",
    ),
    entry(
        "E131: unknown QoS policy or value",
        """QoS policies have the names used by ROS 2: reliability (reliable, best_effort), durability (volatile,
        transient_local), history (keep_last, keep_all), depth, deadline, lifespan, liveliness (automatic,
        manual_by_topic) and lease.""",
        "system s\ncontract Scan = sensor_msgs/msg/LaserScan qos(reliabilty = best_effort)\n",
        "system s\ncontract Scan = sensor_msgs/msg/LaserScan qos(reliability = best_efort)\n",
        "system s\ncontract Scan = sensor_msgs/msg/LaserScan qos(depth = many)\n",
        "system s\ncontract Scan = sensor_msgs/msg/LaserScan qos(deadline = soon)\n",
    ),
    entry(
        "E132: invalid comparison",
        """Field constraints use `=`, `<`, `<=`, `>`, `>=` and `in`; all except `=` and `in {…}` compare numbers.""",
        "system s\ncontract Wide = sensor_msgs/msg/Image where width == 640\n",
        "system s\ncontract Wide = sensor_msgs/msg/Image where encoding != rgb8\n",
        "system s\ncontract Wide = sensor_msgs/msg/Image where encoding > rgb8\n",
    ),
    entry(
        "E133: not a message type",
        """A message type is written `pkg/msg/Type` as in ROS 2 or `pkg/Type` as in ROS 1.""",
        "system s\ncontract Scan = sensor_msgs/srv/msg/LaserScan\n",
        "system s\ncontract Scan = sensor_msgs.msg.LaserScan\n",
        "system s\ncontract Scan = sensor_msgs::msg::LaserScan\n",
    ),
    entry(
        "E134: list with mixed types",
        """List parameters in ROS contain only numbers, only strings or only booleans.""",
        CHATTER.replace("  output", '  parameters { names = ["a", 1] }\n  output') + NODE,
    ),
    entry(
        "E135: `nothing` where a contract is required",
        """`nothing` states that an output produces nothing in a mode. It satisfies no assumption, so it can be
        neither assumed nor the contract of a topic; and it has no rate, QoS or fields.""",
        "system s\ntopic /chatter : nothing\n",
        CHATTER.replace("mode silent { }", "mode silent { guarantee out : nothing @ 1 Hz }") + NODE,
        "system s\ncontract None = nothing\ncontract Less = None where data = 1\n",
    ),
    entry(
        "E136: cycle of contracts",
        """A contract can refine another one, but the chain must end at a message type.""",
        "system s\ncontract A = B @ 5 Hz\ncontract B = A @ 6 Hz\n",
    ),
    entry(
        "E137: unknown field",
        """The message type is installed, but has no such field.""",
        "system s\ncontract Wide = sensor_msgs/msg/Image where widht >= 640\n",
        "system s\ncontract Wide = sensor_msgs/msg/Image where width.x >= 640\n",
    ),
    entry(
        "E138: comparison with the wrong type",
        """The comparison does not match the type of the field (number, string or boolean), or the field is a list or
        a message, which cannot be compared.""",
        "system s\ncontract Wide = sensor_msgs/msg/Image where width = wide\n",
        "system s\ncontract Wide = sensor_msgs/msg/Image where data = 1\n",
    ),
    # -- names -----------------------------------------------------------------------------------------
    entry(
        "E139: private topic outside a node",
        """`~/name` is private to a node. Declare the topic by its full name: `/node/name`.""",
        "system s\ntopic ~/chatter : std_msgs/msg/String\n",
    ),
    entry(
        "E140: cycle of components",
        """A component can be like another one, but the chain must end, after at most 32 steps, at a component
        without `like`.""",
        "system s\ncomponent A like B\ncomponent B like A\n",
        "system s\ncomponent C0 { }\n" + "".join(f"component C{n + 1} like C{n}\n" for n in range(40)),
    ),
    entry(
        "E141: name of both a contract and an input",
        """A contract and an input have the same name, so `assume NAME` is ambiguous: it could mean this input, or
        any input that satisfies the contract.""",
        "system s\ncontract scan = sensor_msgs/msg/LaserScan\n"
        "component C {\n  input scan : sensor_msgs/msg/LaserScan\n}\n",
    ),
    entry(
        "E142: refined assumption on an input",
        """`assume scan` relies on the input with the assumption from its declaration, which a mode cannot refine. An
        assumed contract can be refined.""",
        "system s\ncomponent C {\n  input scan : sensor_msgs/msg/LaserScan\n"
        "  functionality f {\n    uses scan\n"
        "    mode normal { assume scan @ 5 Hz }\n    mode degraded { }\n  }\n}\n",
    ),
    entry(
        "E143: `changeable` in a node",
        """Whether a parameter can be changed in place depends on the program, so it is declared in the component. A
        node only sets values.""",
        CHATTER.replace("  output", "  parameters { volume = 1 }\n  output")
        + "node talker : Talker { out -> /chatter   parameters { changeable volume = 2 } }\n",
    ),
    entry(
        "E144: arrow in the wrong direction",
        """The arrow points in the direction of the messages: `input <- /topic` and `output -> /topic`.""",
        CHATTER + "node talker : Talker { out <- /chatter }\n",
    ),
    entry(
        "E145: too many entries",
        """A declaration has more entries of one kind than any hand-written file, such as a component with over a
        thousand ports. The rest are not checked.""",
        "system s\nenvironment {\n" + "".join(f"guarantee g{n} : a/B\n" for n in range(1001)) + "}\n",
    ),
    entry(
        "E146: restart policy without `respawn`",
        """`respawn_delay`, `respawn_max_retries` and `respawn_fallback` refine `respawn`. As in ROS launch files, they
        have no effect on a node without it.""",
        respawning("respawn_delay 2 s"),
    ),
    entry(
        "E147: type of another kind",
        """The type says whether something is a topic (`pkg/msg/Type`), a service (`pkg/srv/Type`) or a ROS action
        (`pkg/action/Type`), and the declaration has to say the same: outputs and inputs belong to topics, servers and
        clients to services, action servers and action clients to ROS actions. A service `responds within` a bound, a
        ROS action `accepts within` it.""",
        "system s\ntopic /map : nav_msgs/srv/GetMap\n",
        "system s\ncomponent Planner {\n  input map : nav_msgs/srv/GetMap\n}\n",
        "system s\ncontract Dock = nav2_msgs/action/DockRobot responds within 1 s\naction /dock : Dock\n",
        CHATTER.replace("output out", "server out") + NODE,
    ),
    entry(
        "E148: `for all` for a program with one node",
        """`parameters for all { … }` states values for all nodes of a process, as launch does. That is for programs
        that do not use Midstride's API (`gate …` after `run "…"`), which may have several nodes.""",
        CHATTER.replace("  output", "  parameters for all { volume = 1 }\n  output") + NODE,
    ),
    # -- parameter files -------------------------------------------------------------------------------
    entry(
        "E150: invalid ROS parameter file",
        """A parameter file is YAML: a section per node, named as in ROS (with its namespace, or with wildcards),
        each with `ros__parameters`, whose values are strings, numbers, booleans and lists of them. What ROS's own
        parser refuses is refused here as well, since no node starts with such a file: aliases, a list that mixes
        types, a parameter without a value.""",
        CatalogueExample(TALKING + 'parameters "p.yaml"\n', files={"p.yaml": "talker:\n  volume: 3\n"}),
        CatalogueExample(
            TALKING + 'parameters "p.yaml"\n', files={"p.yaml": "talker:\n  ros__parameters:\n    volume: [a, 1]\n"}
        ),
        CatalogueExample(TALKING + 'parameters "p.yaml"\n', files={"p.yaml": "talker: [\n"}),
        CatalogueExample(
            TALKING + 'parameters "p.yaml"\n', files={"p.yaml": "talker:\n  ros__parameters:\n    volume:\n"}
        ),
        CatalogueExample(
            TALKING + 'parameters "p.yaml"\n', files={"p.yaml": "talker: {ros__parameters: " + "{a: " * 100}
        ),
        CatalogueExample(
            TALKING + 'parameters "p.yaml"\n',
            files={"p.yaml": "talker:\n  ros__parameters:\n    gain: &gain 2\n    volume: *gain\n"},
        ),
    ),
    entry(
        "E151: parameter set for only some nodes",
        """A parameter file sets a parameter for one node of a component but not for another, and the component
        declares no value for it: the value for the other node is undefined.""",
        CatalogueExample(
            "system s\ntopic /chatter : std_msgs/msg/String\n"
            + TALKER
            + 'node a : Talker { out -> /chatter }\nnode b : Talker { out -> /chatter }\nparameters "p.yaml"\n',
            files={"p.yaml": "a:\n  ros__parameters:\n    volume: 3\n"},
        ),
    ),
    entry(
        "W160: parameter file without a section for the node",
        """The node names a parameter file, but no section of that file applies to the node.""",
        CatalogueExample(
            CHATTER + 'node talker : Talker { out -> /chatter   parameters "p.yaml" }\n',
            files={"p.yaml": "talkr:\n  ros__parameters:\n    volume: 3\n"},
        ),
    ),
    entry(
        "W161: program that is not there",
        """`run` names a file that does not exist, or the executable of a package that is not installed here; or the
        class of a composable node that no package registers, or a container that is not installed. A relative path is
        relative to the folder of the system's file, where programs are started. A program without a path is looked up
        when it is started, and not checked here.""",
        CHATTER.replace("  output", '  run "python3 talkr.py"\n  output') + NODE,
        CatalogueExample(
            CHATTER.replace("  output", '  run "./bin/talker --fast"\n  output') + NODE, files={"talker.py": "pass\n"}
        ),
    ),
)
