"""A byte-level mutation fuzzer for the language: `python tests/lang/fuzz.py [N] [--seed S]`.

It checks that no input makes `load` or `format_text` raise, that each is handled within a time limit, that formatting
is idempotent and keeps the meaning, and that memory use is limited. `make test-long` runs it on 1,000,000 inputs.
"""

from __future__ import annotations

import argparse
import random
import resource
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from midstride.lang.load import load_text
from midstride.lang.printer import format_text
from midstride.lang.source_files import Unreadable, decode_utf8

SEEDS = Path(__file__).parent / "seeds"
SENSORS = (SEEDS / "sensors.stride").read_text(encoding="utf-8")  # what the sample includes
SECONDS_PER_INPUT = 2.0  # generous, for a busy machine; the median is a thousandth of this
MEGABYTES = 1024

# Meaningful pieces, so that mutations get past the lexer.
_WORDS = rb"""
system s|{|}|(|)|[|]|<-|->|:|=|@|,|.|"|'|#|\|/|~|//|-|1e999|99999999999999999999999999999999999999999999999999|0|-1
|1.5| Hz| s|component C {|functionality f {|mode m {|assume |guarantee out : |node n : C {|namespace a {
|include "a.stride"|contract K = |std_msgs/msg/String| where x in {a, b}| qos(depth = 5)| or | like C |parameters {
|parameters "p.yaml"|keep n.f at m|limit n.f below baseline 2 s|order a before b|timing {|environment {|resource r = 3
|topic /t : K|input |output |uses |produces |run "x" takes 2 s| stop drain 3 s patience 9 s sigterm 1 s sigkill 2 s
| activate 3 s| lazy|changes require /e : std_msgs/msg/Bool where data = true|changes and recovery require | max_age 2 s
|service /s : std_srvs/srv/Trigger|action /a : |server |client |action server |action client | responds within 50 ms
| accepts within 1 s|std_srvs/srv/Trigger|nav2_msgs/action/Spin
"""
_BYTES = (
    b"\0",
    b"\r\n",
    b"\r",
    b"\n",
    b"\xef\xbb\xbf",
    b"\xff",
    b"\xc3",
    b"\xc3\xa9",
    b"\xe2\x80\xa8",
    b"\xf0\x9f\xa4\x96",
)
PIECES = (*_WORDS.strip().split(b"|"), *_BYTES)


def mutated(data: bytes, others: list[bytes], rng: random.Random) -> bytes:
    """``data`` with a few random changes."""
    text = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 3, 5, 9))):
        at = rng.randrange(len(text) + 1)
        kind = rng.randrange(9)
        if kind == 0 and text:
            text[min(at, len(text) - 1)] = rng.randrange(256)
        elif kind == 1:
            text[at:at] = rng.choice(PIECES)
        elif kind == 2:
            del text[at : at + rng.choice((1, 2, 5, 20, 80))]
        elif kind == 3:
            end = at + rng.choice((1, 5, 20, 80))
            text[at:at] = text[at:end]
        elif kind == 4:
            other = rng.choice(others)
            start = rng.randrange(len(other) + 1)
            text[at:at] = other[start : start + rng.choice((5, 40, 200))]
        elif kind == 5:
            lines = bytes(text).split(b"\n")
            rng.shuffle(lines) if rng.random() < 0.1 else lines.insert(rng.randrange(len(lines)), rng.choice(lines))
            text = bytearray(b"\n".join(lines))
        elif kind == 6:
            lines = bytes(text).split(b"\n")
            del lines[rng.randrange(len(lines))]
            text = bytearray(b"\n".join(lines))
        elif kind == 7:
            text[at:at] = rng.choice(PIECES) * rng.choice((2, 10, 100))
        else:
            words = bytes(text).split(b" ")
            i, j = rng.randrange(len(words)), rng.randrange(len(words))
            words[i], words[j] = words[j], words[i]
            text = bytearray(b" ".join(words))
        if len(text) > 100_000:
            del text[100_000:]
    return bytes(text)


def check(data: bytes) -> str:
    """Handle one input as the command line would; raises if the language has a defect. Returns how far it got."""
    try:
        text = decode_utf8(data)
    except Unreadable:
        return "not text"
    files = {Path("a.stride"): text, Path("p.yaml"): text, Path("sensors.stride"): SENSORS}

    def read(path: Path) -> str:
        if path not in files:
            raise FileNotFoundError(2, "No such file or directory")
        return files[path]

    loaded = load_text(text, "fuzz.stride", read=read)
    assert (loaded.specification is None) == loaded.has_errors
    for diagnostic in loaded.diagnostics:
        assert diagnostic.message
        diagnostic.render()
        diagnostic.to_json()
    formatted = format_text(text)
    if formatted.text is None:
        assert formatted.diagnostics
        return "not parsed"
    again = format_text(formatted.text)
    assert again.text == formatted.text, "formatting twice changes something"
    if loaded.specification is None:
        return "parsed"
    files[Path("a.stride")] = formatted.text
    meant = load_text(formatted.text, "fuzz.stride", read=read).specification
    assert meant == loaded.specification, "formatting changes the meaning"
    return "loaded"


def inputs(count: int, seed: int) -> Iterator[bytes]:
    rng = random.Random(seed)
    seeds = [path.read_bytes() for path in sorted(SEEDS.iterdir())]
    pool = list(seeds)
    for number in range(count):
        data = mutated(rng.choice(seeds if rng.random() < 0.5 else pool), pool, rng)
        if number % 50 == 0:  # let changes accumulate
            pool = [*seeds, *pool[len(seeds) :][-100:], data]
        yield data


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("count", type=int, nargs="?", default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    slowest, began = 0.0, time.perf_counter()
    for number, data in enumerate(inputs(arguments.count, arguments.seed)):
        start = time.process_time()
        try:
            check(data)
        except Exception:
            print(f"input {number} of seed {arguments.seed}: {data!r}", file=sys.stderr)
            raise
        taken = time.process_time() - start
        slowest = max(slowest, taken)
        if taken > SECONDS_PER_INPUT:
            print(f"input {number} of seed {arguments.seed} took {taken:.1f} s: {data!r}", file=sys.stderr)
            return 1
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    elapsed = time.perf_counter() - began
    print(f"{arguments.count} inputs, {elapsed:.0f} s, slowest {slowest:.3f} s, at most {used} MB")
    return 0 if used < MEGABYTES else 1


if __name__ == "__main__":
    sys.exit(main())
