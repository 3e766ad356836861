"""Names, types, reasons, parameter values and output that a foreign node chose are text on the page, never markup."""

from __future__ import annotations

import json
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from midstride.runtime.records.reports import Event
from midstride.runtime.records.status_forms import CrashedInstance, EndpointStatus, RespawnStatus
from tests.browser.conftest import PATIENCE
from tests.browser.synthetic import Synthetic, component, functionality, parameter, port, serving

pytestmark = [pytest.mark.browser, pytest.mark.full]


def respawn(words: str) -> RespawnStatus:
    return RespawnStatus(restarting=False, seconds=None, restarts=1, max_retries=1, window=60.0, words=words)


HOSTILE = [
    "<img src=x onerror=attacked()>",
    "<script>attacked()</script>",
    '"><svg onload=attacked()>',
    "javascript:attacked()",
    "</title></text><foreignObject><iframe srcdoc='<script>parent.attacked()</script>'></iframe></foreignObject>",
    "__proto__",
    "constructor",
    "\u202egnp.exe\u0000\u001b[31m",
    "x" * 5_000,
]


def hostile_system() -> Synthetic:
    components = []
    for number, text in enumerate(HOSTILE):
        mode = functionality(f"work {text}", f"mode {text}", because=f"because {text}")
        parameters = [parameter(f"name {text}", f"value {text}")]
        more: dict[str, Any] = {
            "component": f"type {text}",
            "namespace": f"/{text}",
            "node": text,
            "waiting": f"waiting {text}",
            "differences": [f"difference {text}"],
            "deviation": f"deviation {text}",
        }
        ports = [port(f"out {text}", "out", text, type=text), port(f"in {text}", "in", HOSTILE[number - 1])]
        shared = EndpointStatus(kind="service", name=HOSTILE[number // 2], serves=bool(number % 2))
        endpoints = [shared, EndpointStatus(kind="topic", name=text, serves=None)]
        components.append(component(text, [mode], ports, parameters=parameters, endpoints=endpoints, **more))
    crashes = [
        CrashedInstance(name=each, role=each, status=1, log=each, remedy=each, respawn=respawn(each), words=each)
        for each in HOSTILE[:3]
    ]
    synthetic = Synthetic(components, crashes)
    synthetic.events = [
        Event(n=number + 1, at=1_000_000_000.0, kind=text, words=text) for number, text in enumerate(HOSTILE)
    ]
    return synthetic


def nothing_attacked(page: Page) -> None:
    assert page.evaluate("window.attacks") == 0
    assert page.locator("img, iframe, foreignObject, svg svg, body script").count() == 0


@pytest.mark.parametrize("policy", ["with the policy", "without it"])
def test_no_text_becomes_markup(browser: Browser, policy: str) -> None:
    """Also without the content security policy: it is a second line of defence."""
    context = browser.new_context(viewport={"width": 1400, "height": 900}, bypass_csp=policy == "without it")
    context.set_default_timeout(PATIENCE)
    context.add_init_script("window.attacks = 0; window.attacked = () => { window.attacks += 1; };")
    faults: list[str] = []
    context.on("weberror", lambda error: faults.append(str(error.error)))
    page = context.new_page()
    with serving(hostile_system()) as synthetic:
        page.route("**/api/v1/why?**", lambda route: route.fulfill(status=200, json=why()))
        page.goto(synthetic.url)
        page.wait_for_selector(".graph .component[transform]")
        expect(page.locator(".component")).to_have_count(len(HOSTILE))
        expect(page.locator(".event-list li")).to_have_count(len(HOSTILE))
        nothing_attacked(page)
        for text in HOSTILE:
            choose(page, text)
            expect(page.locator("#details h2")).to_contain_text(text[:30])
            page.locator("#details").get_by_role("button", name="why?").click()
            expect(page.locator("#details .chain li")).to_have_count(len(HOSTILE))
            nothing_attacked(page)
        choose(page, f"service {HOSTILE[0]}", topic=True)
        expect(page.locator("#details h2")).to_have_text(f"service {HOSTILE[0]}")
        nothing_attacked(page)
        choose(page, HOSTILE[0], topic=True)
        expect(page.locator("#details h2")).to_have_text(HOSTILE[0])
        page.keyboard.press("/")
        page.keyboard.type("<")
        expect(page.locator("#found [role=option]").first).to_be_visible()
        nothing_attacked(page)
    context.close()
    assert faults == []


def choose(page: Page, text: str, topic: bool = False) -> None:
    """By a click, wherever it is on the graph."""
    attribute = "topic" if topic else "name"
    page.evaluate(
        """([attribute, text]) => [...document.querySelectorAll(`.graph [data-${attribute}]`)]
            .find((each) => each.dataset[attribute] === text)
            .dispatchEvent(new MouseEvent("click", {bubbles: true}))""",
        [attribute, text],
    )


def why() -> dict[str, Any]:
    document = {"functionality": "", "instance": HOSTILE[0], "mode": "", "normal": False, "because": HOSTILE[0]}
    answer: dict[str, Any] = json.loads(json.dumps({**document, "chain": HOSTILE, "inputs": {HOSTILE[0]: False}}))
    return answer
