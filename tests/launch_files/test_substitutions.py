"""Substitutions: their grammar is that of ROS 2, their values too, and none runs or reads what a stranger chooses."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.launch_files.allowed_files import ReadableFiles
from midstride.launch_files.context import Context, IncludeTrace
from midstride.launch_files.expression import evaluate
from midstride.launch_files.findings import UnknownValue
from midstride.launch_files.packages import Packages
from midstride.launch_files.substitutions import SubstitutionCall, Template, parse, substituted


def context(**variables: str) -> Context:
    file = "/robot/launch/a.launch.xml"
    files = ReadableFiles(Path(file), [])
    return Context(
        Packages({}, []), files, {"HOME": "/home/robot"}, file, IncludeTrace(file), variables=dict(variables)
    )


def tree(template: Template) -> object:
    return [
        part if isinstance(part, str) else (part.name, [tree(each) for each in part.arguments]) for part in template
    ]


# What ROS 2's own parser (launch.frontend.parse_substitution) makes of them.
GRAMMAR = {
    "plain": ["plain"],
    "a$b": ["a$b"],
    "\\$(x)": ["$(x)"],
    "/$(var a)/b": ["/", ("var", [["a"]]), "/b"],
    "$(var 'a b')": [("var", [["a b"]])],
    "$(env A b)": [("env", [["A"], ["b"]])],
    "$(if $(var a) 'x y' z)": [("if", [[("var", [["a"]])], ["x y"], ["z"]])],
    "$(var a\\(b\\))": [("var", [["a(b)"]])],
    "$(var $(var a)_b)": [("var", [[("var", [["a"]]), "_b"]])],
    """$(eval "'$(var x)'.split('/')[0]")""": [("eval", [["'", ("var", [["x"]]), "'.split('/')[0]"]])],
    """$(eval '"$(var x)" == "a\\'b"')""": [("eval", [['"', ("var", [["x"]]), '" == "a\'b"']])],
}


@pytest.mark.parametrize("text", GRAMMAR)
def test_the_grammar_is_that_of_ros(text: str) -> None:
    assert tree(parse(text)) == GRAMMAR[text]


@pytest.mark.parametrize("text", ["$(a", "$(", "$()", "$(var a  b)", "$(var 'a)", '$(var a"b)', "$(1)", "$(a " * 40])
def test_what_ros_cannot_parse_has_no_value(text: str) -> None:
    with pytest.raises(UnknownValue, match="is not a valid substitution"):
        parse(text)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("$(var a)/$(var b)", "1/x"),
        ("$(var missing else)", "else"),
        ("$(env HOME)", "/home/robot"),
        ("$(env NONE none)", "none"),
        ("$(dirname)/b", "/robot/launch/b"),
        ("$(filename)", "/robot/launch/a.launch.xml"),
        ("$(equals $(var a) 1.0)", "true"),
        ("$(not-equals true True)", "false"),
        ("$(and true $(not false))", "true"),
        ("$(any false 0 true)", "true"),
        ("$(if $(var a) yes $(var missing))", "yes"),
        ("""$(eval "'$(var b)' == 'x' and 2 ** 3 > 7")""", "True"),
    ],
)
def test_values(text: str, value: str) -> None:
    assert substituted(text, context(a="1", b="x")) == value


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("$(command 'cat /etc/passwd')", "runs a program, `cat /etc/passwd`; `--run-commands` carries it out"),
        ("$(file-content /etc/passwd)", "it is not below the folder of the launch file"),
        ("$(file-content a.txt)", "is relative to the folder in which launch is started"),
        ("$(anon name)", "not carried out"),
        ("$(find-exec no_such_tool)", "there is no executable `no_such_tool` in the PATH"),
        ("$(env NONE)", "environment variable `NONE` is not set"),
        ("$(var missing)", "`missing` is not set"),
        ("$(find-pkg-share nix)", "package `nix` is not here"),
        ("$(find-pkg-share ../../etc)", "is not here"),
        ("$(equals a)", "wrong number of arguments"),
        ("$(not maybe)", "neither true nor false"),
    ],
)
def test_what_has_no_value_says_why(text: str, why: str) -> None:
    with pytest.raises(UnknownValue, match=why):
        substituted(text, context())


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("'a/b'.split('/')[1] if '/' in 'a/b' else ''", "b"),
        ("len(['a', 'b']) > 1", "True"),
        ("0.0 + 1.5", "1.5"),
        ("'yabloc' in ['ndt']", "False"),
        ("'centerpoint_tiny'.replace('centerpoint_', '', 1)", "tiny"),
        ("list(set('ndt_artag'.split('_')).intersection(['ndt', 'eagleye']))", "['ndt']"),
        ("set(['b', 'a'])", "{'a', 'b'}"),
        ("round(math.sin(pi / 2)) // 1", "1"),
        ("[1, 2, 3][1:]", "[2, 3]"),
        ("not 1 < 2 < 3", "False"),
        ("True or undefined", "True"),
        ("(1, 2) + (3,)", "(1, 2, 3)"),
    ],
)
def test_expressions_have_the_values_of_python(text: str, value: str) -> None:
    assert evaluate(text) == value


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "open('/etc/passwd').read()",
        "().__class__.__bases__",
        "'{0.__class__}'.format(1)",
        "'%s' % 1",
        "(lambda: 1)()",
        "[x for x in [1]]",
        "exec('1')",
        "'a' * 10 ** 9",
        "9 ** 9 ** 9",
        "2 ** 64 * 2 ** 64 * 2 ** 64 * 2 ** 64 * 2 ** 64",
        "('x' * 90000).replace('x', 'y' * 90000)",
        "[[[0] * 90000] * 2] * 90000",
        "1 / 0",
        "'a",
        "len",
        "(" * 500 + ")" * 500,
        "true",
    ],
)
def test_other_expressions_have_no_value(text: str) -> None:
    with pytest.raises(UnknownValue):
        evaluate(text)


def test_a_call_keeps_its_text() -> None:
    (call,) = parse("$(var a)")
    assert isinstance(call, SubstitutionCall) and call.text == "$(var a)"
