"""The HTML text of a report: its data, the page's modules and their styles, and nothing from elsewhere."""

from __future__ import annotations

import base64
import hashlib
import html
from functools import cache
from pathlib import Path
from typing import Any, Final

import msgspec

from midstride.server.report.modules import inlined

DASHBOARD: Final = Path(__file__).parents[1] / "dashboard"
_STYLES: Final = ("style.css", "graph/graph.css", "timeline/timeline.css", "change/change.css", "report/report.css")
_LAYOUT: Final = "vendor/elkjs/elk-worker.min.js"
_HTML: Final = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<main id="report"></main>
<noscript>This file draws its graph and its figures with JavaScript, which is switched off.</noscript>
<script type="application/json" id="data">{data}</script>
<!-- elkjs (https://github.com/kieler/elkjs) lays out the graph; Eclipse Public License 2.0 -->
<script>{layout}</script>
<script type="module">{script}</script>
</body>
</html>
"""


def report_file(document: Any, title: str) -> str:
    """The file for ``document``, whose form is described in docs/how-to/report.md."""
    # In a page, `<` could end the element: in JSON, it may be written otherwise everywhere.
    data = msgspec.json.encode(document).decode().replace("<", "\\u003c").replace("\u2028", "\\u2028")
    return _HTML.format(title=html.escape(title), data=data, **_parts())


@cache
def _parts() -> dict[str, str]:
    """The parts that are the same in every report."""
    worker = (DASHBOARD / _LAYOUT).read_text(encoding="utf-8")
    # A page from disk can start no worker: the library then runs in the page, as its own package does without one.
    layout = f"(function () {{ var module = {{ exports: {{}} }}, exports = module.exports;\n{worker}\n"
    layout += "globalThis.midstrideWorker = module.exports.Worker || module.exports.default; })();"
    script = inlined(DASHBOARD, "report/report.js")
    style = "\n".join((DASHBOARD / name).read_text(encoding="utf-8") for name in _STYLES)
    for text in (layout, script, style):
        assert "</script" not in text and "</style" not in text and "<!--" not in text
    policy = (
        f"default-src 'none'; script-src {_hash(layout)} {_hash(script)}; style-src {_hash(style)}; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
    return {"policy": policy, "style": style, "layout": layout, "script": script}


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
