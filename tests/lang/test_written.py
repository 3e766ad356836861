"""Random specifications, with services and ROS actions: written as text, read, and formatted, they say the same."""

from __future__ import annotations

from hypothesis import given

from midstride.lang import format_text, load_text, render
from midstride.model.specification import Specification
from tests.lang.written import stride
from tests.strategies.systems import specifications


def means(text: str, specification: Specification) -> None:
    loaded = load_text(text)
    assert not loaded.has_errors, render(loaded.diagnostics)
    assert loaded.require() == specification


@given(specifications())
def test_a_text_says_what_was_written_and_so_does_its_canonical_form(specification: Specification) -> None:
    text = stride(specification)
    means(text, specification)
    canonical = format_text(text).text
    assert canonical is not None
    means(canonical, specification)
    assert format_text(canonical).text == canonical
