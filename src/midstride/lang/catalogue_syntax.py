"""The catalogue of syntax errors: files, characters and statements (E100 to E129, E199)."""

from __future__ import annotations

from typing import Final

from midstride.lang.catalogue_entry import CHATTER, NODE, TALKER, TALKING, CatalogueExample, entry

_MANY: Final = {f"part{n}.stride": f'include "part{n + 1}.stride"\n' for n in range(40)}

SYNTAX: Final = (
    # -- files -----------------------------------------------------------------------------------------
    entry(
        "E100: file cannot be read",
        """The file does not exist, cannot be read or is not a regular file. Paths of includes and parameter files
        are relative to the file that names them, or begin with `package://PACKAGE/` and are below the share folder of
        that package.""",
        'system s\ninclude "missing.stride"\n',
        'system s\nparameters "missing.yaml"\n' + TALKING.removeprefix("system s\n"),
        'system s\ninclude ""\n',
    ),
    entry(
        "E101: file is not UTF-8",
        """Files are encoded in UTF-8, with or without a byte order mark. The message gives the position of the first
        invalid byte.""",
        b"system caf\xe9\n",
        "system s\n".encode("utf-16"),
        CatalogueExample('system s\ninclude "latin.stride"\n', files={"latin.stride": b"# caf\xe9\n"}),
    ),
    entry(
        "E102: file too large",
        """Files are limited to four megabytes, far more than a hand-written specification needs. This is probably
        the wrong file.""",
        "system s\n" + "# padding\n" * 420_000,
    ),
    entry(
        "E103: include cycle",
        """Files include each other in a cycle. The message lists the files of the cycle in order.""",
        'system s\ninclude "example.stride"\n',
        CatalogueExample(
            'system s\ninclude "a.stride"\n',
            files={"a.stride": 'include "b.stride"\n', "b.stride": 'include "a.stride"\n'},
        ),
    ),
    entry(
        "E104: include limit exceeded",
        """The number of files, their total size and the depth of includes are limited, so that loading ends even if
        a file includes itself under many names.""",
        CatalogueExample('system s\ninclude "part0.stride"\n', files=dict(_MANY)),
    ),
    entry(
        "E105: included file is a system",
        """An included file is a fragment: it has no `system` line, because the file that includes it names the
        system.""",
        CatalogueExample('system s\ninclude "other.stride"\n', files={"other.stride": "system other\n"}),
    ),
    entry(
        "E106: no system name",
        """The file to check, launch or plan for starts with `system NAME`. A fragment has no such line; check the
        file that includes it, because a fragment alone may lack declarations.""",
        "topic /chatter : std_msgs/msg/String\n",
        "",
    ),
    entry(
        "E107: file may not be read",
        """Diagnostics quote the files that they are about. So that somebody else's specification cannot print any file
        of this machine, it reads files only from below the folder of the file that names the system and from packages
        that are installed in the workspaces that you have sourced, and only `.stride` files and, for parameters,
        `.yaml` and `.yml` files. Other folders can be named with
        `midstride --include-path DIR`, or in the environment variable MIDSTRIDE_INCLUDE_PATH.""",
        'system s\ninclude "../sensors.stride"\n',
        'system s\ninclude "secrets.env"\n',
        'system s\nparameters "/proc/self/environ"\n' + TALKING.removeprefix("system s\n"),
    ),
    entry(
        "E108: package not found",
        """A file of a package is named `package://PACKAGE/FILE`, where FILE is below `share/PACKAGE` of where the
        package is installed. The package must be in a workspace whose `setup.bash` is sourced: packages are looked up
        in AMENT_PREFIX_PATH, and those of ROS 1 below ROS_PACKAGE_PATH. FILE cannot lead out of the package.""",
        'system s\ninclude "package://robot_parts/arm.stride"\n',
        'system s\ninclude "package://arm.stride"\n',
        'system s\nparameters "package://robot_parts/arm.yaml"\n' + TALKING.removeprefix("system s\n"),
    ),
    # -- characters -----------------------------------------------------------------------------------------
    entry(
        "E110: unexpected character",
        """The character is not part of the language. Names consist of ASCII letters, digits and underscores, joined
        by slashes, as in ROS. Put a device path with other characters in double quotes.""",
        "system s\ntopic /chatter : std_msgs/msg/String;\n",
        "system s\ntopic /scän : std_msgs/msg/String\n",
        "system s\nresource /dev/ttyUSB-0\n",
        "system s\n// a comment\n",
    ),
    entry(
        "E111: invalid name",
        """A part of the name is empty or starts with a digit, or the name has more than 255 characters.""",
        "system s\ntopic /front//scan : std_msgs/msg/String\n",
        "system s\ntopic /scan/ : std_msgs/msg/String\n",
    ),
    entry(
        "E112: string in single quotes",
        """Strings use double quotes. They can contain single quotes, as in a command.""",
        CHATTER.replace("  output out\n", "  run 'python3 -m talker'\n  output out\n") + NODE,
    ),
    entry(
        "E113: unterminated or too long string",
        """A string ends on the line on which it starts, and has at most 8192 characters.""",
        CHATTER.replace("  output out\n", '  run "python3 -m talker\n  output out\n') + NODE,
    ),
    entry(
        "E114: unknown escape sequence",
        r"""In a string, `\"` is a double quote, `\\` a backslash, `\n` a new line and `\t` a tab. There are no other
        escape sequences.""",
        CHATTER.replace("  output out\n", '  run "python3 -m talker \\d"\n  output out\n') + NODE,
    ),
    entry(
        "E115: NUL byte",
        """A text file contains no NUL bytes: this is probably a binary file, or one in UTF-16 or UTF-32.""",
        "system s\n\0\n",
    ),
    # -- statements ------------------------------------------------------------------------------------
    entry(
        "E120: syntax error",
        """The language requires something else at this place. The statement is skipped, and parsing continues with
        the next one.""",
        "system s\ntopic /chatter std_msgs/msg/String\n",
        "system s\ncontract Scan = @ 10 Hz\n",
        "system s\ntopic /chatter : std_msgs/msg/String 10 Hz\n",
        'system s\ntopic /a : std_msgs/msg/String where data in {"a", "b"\ntopic /b : std_msgs/msg/String\n',
        CHATTER + "node talker : Talker { out /chatter }\n",
        CHATTER.replace("output out", "output out : std_msgs/msg/String") + NODE,
        CHATTER.replace("output out", "allows action ~/dock\n  output out") + NODE,
        "system s\ninclude sensors.stride\n",
        "system s\nenvironment { guarantee camera on : std_msgs/msg/String }\n",
        TALKING + "keep talker.talk normal\n",
        TALKING + "timing { create = 1 s }\n",
        TALKING + "wibble wobble\n",
    ),
    entry(
        "E121: unknown statement",
        """No statement that is allowed here starts with this word. It resembles a keyword and was parsed as that.""",
        "system s\ntopik /chatter : std_msgs/msg/String @ 10 Hz\n" + TALKER + NODE,
        CHATTER.replace("produces", "produce") + NODE,
    ),
    entry(
        "E122: statement in the wrong block",
        """This statement belongs in another block, which the message names.""",
        CHATTER.replace("  output out\n", "  output out\n  assume out\n") + NODE,
    ),
    entry(
        "E123: block not closed",
        """The closing brace of the block is missing: a statement of an outer block follows, or the file ends.""",
        CHATTER.replace("10 Hz }\n    mode silent", "10 Hz\n    mode silent") + NODE,
        "system s\ncomponent Talker {\n  output out\n",
    ),
    entry(
        "E124: unmatched closing brace",
        """There are more closing braces than open blocks.""",
        TALKING + "}\n",
    ),
    entry(
        "E125: keyword used as a name",
        """The keywords that start statements cannot be names: lists need no comma, so the next statement would look
        like the next name.""",
        CHATTER + "component Filter {\n  input input : std_msgs/msg/String\n}\n" + NODE,
    ),
    entry(
        "E126: number out of range",
        """Rates must be greater than 0, and the numbers of publishers and of missed messages must be whole. Numbers are
        at most 1e18, in Hz and seconds.""",
        "system s\ntopic /chatter : std_msgs/msg/String @ 0 Hz\n" + TALKER + NODE,
        TALKING + "resource memory = 1e999\n",
        "system s\ntopic /chatter : std_msgs/msg/String @ 1e18 kHz\n" + TALKER + NODE,
        "system s\ntopic /chatter : std_msgs/msg/String { publishers <= 1.5 }\n" + TALKER + NODE,
        CHATTER.replace("  output", "  input a : std_msgs/msg/String @ 1 Hz tolerates 0 missed\n  output") + NODE,
        CHATTER.replace("  output", "  parameters { seed = 9999999999999999999 }\n  output") + NODE,
    ),
    entry(
        "E127: missing or unknown unit",
        """Rates need the unit `Hz` or `kHz`; times need `s`, `ms`, `us` or `min`.""",
        "system s\ntopic /chatter : std_msgs/msg/String @ 10\n" + TALKER + NODE,
        "system s\ntopic /chatter : std_msgs/msg/String @ 10 hz\n" + TALKER + NODE,
        TALKING + "limit talker.talk below baseline 2\n",
        "system s\ntopic /chatter : std_msgs/msg/String qos(deadline = 1)\n",
        "system s\ntopic /chatter : std_msgs/msg/String qos(deadline = 1 parsec)\n",
    ),
    entry(
        "E128: stated more than once",
        """Something that can be stated only once is stated again.""",
        "system s\nsystem t\n",
        "system s\ncontract Scan = sensor_msgs/msg/LaserScan @ 10 Hz @ 20 Hz\n",
        "system s\ncontract Scan = sensor_msgs/msg/LaserScan qos(depth = 1) qos(depth = 2)\n",
        "system s\ncontract Scan = sensor_msgs/msg/LaserScan qos(depth = 1, depth = 2)\n",
        CHATTER.replace("  output", '  run "a"\n  run "b"\n  output') + NODE,
        "system s\ntopic /chatter : std_msgs/msg/String { publishers <= 1   publishers <= 2 }\n" + TALKER + NODE,
    ),
    entry(
        "E129: namespaces nested too deep",
        """Namespaces are nested deeper than any hand-written file needs. A namespace can combine several names:
        `namespace a/b`.""",
        "system s\n" + "namespace n { " * 20 + "} " * 20 + "\n",
    ),
    entry(
        "E199: too many errors",
        """There are too many errors to show all of them. One of the first errors may be the cause of the rest, or
        the file may be in another language.""",
        "system s\n" + "wibble\n;\n" * 120,
    ),
)
