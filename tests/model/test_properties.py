"""The properties, on random systems: the same ones at every run."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests import drawn
from tests.model.properties import PROPERTIES, Property

_SLOW = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]


def run(prop: Property, examples: int) -> None:
    profile = settings(
        max_examples=examples,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=_SLOW,
    )
    profile(given(st.data())(prop))()


@pytest.mark.parametrize("prop", PROPERTIES, ids=lambda prop: prop.__name__)
def test_briefly(prop: Property) -> None:
    run(prop, drawn.examples(PROPERTIES[prop]))


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("prop", PROPERTIES, ids=lambda prop: prop.__name__)
def test_at_length(prop: Property) -> None:
    run(prop, 15 * PROPERTIES[prop])
