"""Problems as data: what follows from another one is left out, and an unknown name has a near miss."""

from __future__ import annotations

from midstride.model.diagnostics import Problem, independent, with_suggestions

UNKNOWN = Problem("E008", ("nodes", "a", "component"), "there is no component `T`", declared=("components", "T"))


def test_a_name_is_not_unknown_where_the_section_that_may_declare_it_could_not_be_read() -> None:
    for subject in ((), ("components",), ("components", "T")):
        unread = Problem("E001", subject, "this is no object")
        assert independent([unread], [UNKNOWN]) == [unread]
    elsewhere = Problem("E001", ("connectors",), "this is no object")
    assert independent([elsewhere], [UNKNOWN]) == [elsewhere, UNKNOWN]


def test_only_an_unknown_entry_like_the_section_may_be_that_section_misspelt() -> None:
    unknown = Problem("E008", ("nodes", "a", "component"), "there is no component `T`", declared=("components",))
    for subject, code, kept in [
        (("componets",), "E002", False),
        (("componets",), "E005", True),  # known, whatever is wrong with it
        (("timing",), "E002", True),
        (("nodes", "componets"), "E002", True),  # elsewhere
    ]:
        other = Problem(code, subject, "something is wrong")
        assert independent([other], [unknown]) == ([other, unknown] if kept else [other]), (subject, code)


def test_an_unknown_name_has_a_near_miss_or_what_is_known() -> None:
    def problem(*known: str) -> Problem:
        return Problem("E008", ("nodes",), "there is no component `Talkr`", candidates=("Talkr", known))

    found = with_suggestions([problem("Talker"), problem("Camera"), problem(), Problem("E002", (), "else")])
    helped = ["did you mean `Talker`?", "known: Camera", "no such name is declared", ""]
    assert [each.help for each in found] == helped
    assert {each.candidates for each in found} == {None}
