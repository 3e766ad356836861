"""What the strategies disrupt: `minimal`, `paper`, `quiesce` and `stop` on the same changes, beside the proved bound.

The changes are the acts of the examples, one after another; a restart of each node of Autoware's control loop; and
random robots (``tests/plan/systems.py``), half of them with few edits of a small system, half with two to four nodes
replaced that share two resources of which there is hardly enough. Every plan is replayed, which checks its costs, and
the bound as well where the change is small enough. Disruption is in weighted functionality-seconds.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from midstride.cli.example import find, known_examples  # noqa: E402
from midstride.errors import PlanRefused  # noqa: E402
from midstride.lang.load import load  # noqa: E402
from midstride.model.specification import Specification, initial  # noqa: E402
from midstride.plan.change_builder import requested_change  # noqa: E402
from midstride.plan.plan import Plan  # noqa: E402
from midstride.plan.request import PlanRequest  # noqa: E402
from midstride.plan.strategies.registry import STRATEGIES  # noqa: E402
from tests.plan import systems  # noqa: E402
from tests.replay.plan_replay import replay  # noqa: E402

ROBOTS = 200


@dataclass(frozen=True)
class Case:
    """One change. Those of one ``group`` are one row of the table."""

    group: str
    start: Specification
    target: Specification
    restart: tuple[str, ...] = ()

    def plan(self, strategy: str) -> Plan:
        request = PlanRequest(to=self.target, restart=self.restart, strategy=strategy)
        return STRATEGIES[strategy](requested_change(initial(self.start), self.start, request, self.target))


def examples() -> Iterator[Case]:
    """The acts of each example, each from where the one before it ended."""
    for name in known_examples():
        demo = find(name)
        start = demo.specification
        for step in demo.steps:
            target = step.request.target(start)
            yield Case(f"{name}: {step.name}", start, target, step.request.restart)
            start = target


def autoware() -> Iterator[Case]:
    loop = load(ROOT / "examples" / "autoware_control" / "autoware_control.stride").require()
    for role in sorted(loop.nodes):
        yield Case(f"autoware: restart {role}", loop, loop, (role,))


def robots(number: int) -> Iterator[Case]:
    for seed in range(number):
        rng = Random(seed)
        if seed % 2:
            yield Case("robots, scarce resources", *systems.tight(rng, rng.randint(2, 4)))
        else:
            yield Case("robots", *systems.change(rng, systems.system(rng, 6, 4), 4))


def measured(case: Case) -> dict[str, Any]:
    """The disruption by strategy (None: refused), the bound, and what the replay says of it."""
    row: dict[str, Any] = {"group": case.group}
    for strategy in STRATEGIES:
        try:
            plan = case.plan(strategy)
        except PlanRefused:
            row[strategy] = None
            continue
        result = replay(plan)
        if not result.holds:
            raise AssertionError(f"{case.group}, {strategy}: {result}")
        row[strategy] = plan.disruption
        if strategy == "minimal":
            row |= {"bound": plan.lower_bound, "proved": plan.proved_minimal, "checked": result.bound.outcome}
    return row


def is_least(row: dict[str, Any]) -> bool:
    """Whether `minimal` has a plan, and no other strategy a better one."""
    others = [row[name] for name in STRATEGIES if row[name] is not None]
    return row["minimal"] is not None and bool(row["minimal"] <= min(others) + 1e-6)


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A line for each group: means over the changes that every strategy has a plan for."""
    found = []
    for group in dict.fromkeys(row["group"] for row in rows):
        of_group = [row for row in rows if row["group"] == group]
        planned = [row for row in of_group if all(row[name] is not None for name in STRATEGIES)]
        line: dict[str, Any] = {"group": group, "changes": len(of_group), "planned": len(planned)}
        for name in ("bound", *STRATEGIES):
            line[name] = statistics.fmean(row[name] for row in planned) if planned else None
        line["proved"] = sum(row.get("proved", False) for row in of_group)
        above = [row for row in of_group if row.get("bound", 0.0) > 0.0]
        line["above"], line["checked"] = len(above), sum(row["checked"] == "holds" for row in above)
        line["undisturbed"] = {name: sum(row[name] == 0.0 for row in planned) for name in STRATEGIES}
        found.append(line)
    return found


def table(lines: list[dict[str, Any]]) -> Iterator[str]:
    """The lines, as text. ``checked`` counts the bounds above 0 that the replay confirms; one of 0 needs no check."""
    width = max(len(line["group"]) for line in lines)
    header = " ".join(f"{name:>15}" for name in ("minimal", "paper", "quiesce", "stop"))
    yield f"{'':<{width}} {'planned':>10} {'bound':>6} {header} {'proved':>6} {'checked':>8}"
    for line in lines:
        costs = " ".join(
            f"{'-':>15}" if line[name] is None else f"{line[name]:>9.2f} ({line['undisturbed'][name]:>3})"
            for name in ("minimal", "paper", "quiesce", "stop")
        )
        bound = "-" if line["bound"] is None else f"{line['bound']:.2f}"
        planned, checked = f"{line['planned']} of {line['changes']}", f"{line['checked']} of {line['above']}"
        yield f"{line['group']:<{width}} {planned:>10} {bound:>6} {costs} {line['proved']:>6} {checked:>8}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=ROBOTS, help="how many random robots")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "quality.json")
    options = parser.parse_args()

    rows = [measured(case) for cases in (examples(), autoware(), robots(options.robots)) for case in cases]
    lines = summary(rows)
    print("Mean disruption (in brackets: how many changes disrupt nothing)")
    print("\n".join(table(lines)))
    least = all(is_least(row) for row in rows)
    proved = all(row.get("proved") for row in rows)
    verdict = {"minimal_is_never_worse": least, "every_bound_is_met": proved}
    print(", ".join(f"{name.replace('_', ' ')}: {'yes' if held else 'NO'}" for name, held in verdict.items()))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps({"lines": lines, "rows": rows, "verdict": verdict}, indent=2) + "\n")
    return 0 if all(verdict.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
