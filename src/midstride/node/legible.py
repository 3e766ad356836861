"""Text that user code or a message has made, as logs, state reports and ROS can carry it."""

from __future__ import annotations

from typing import Final

# A longer text is shown without its middle (characters): each report of the state carries it.
LONGEST: Final = 8_000


def legible(text: str) -> str:
    """``text`` without what UTF-8 cannot express (lone surrogates, of ``surrogateescape`` for example), and bounded."""
    half, left_out = LONGEST // 2, len(text) - LONGEST
    if left_out > 0:
        text = f"{text[:half]}\n[{left_out} characters are left out here]\n{text[-half:]}"
    return text.encode("utf-8", "backslashreplace").decode()
