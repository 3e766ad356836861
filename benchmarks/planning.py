"""What planning costs against the size of the system, the change and its forward cone being the same.

Systems of 1,000 to 100,000 components are built of copies of one cell: a sensor, a filter, two
that use the filter's topic, and one that uses theirs. In each, one filter is replaced; its cone is
its cell. `best` is worked out from nothing (linear in the system); everything else is timed warm,
once the running configuration is there: the request's target, the change, and the plan by each strategy.
Then 1,000 of the filters of the largest system are replaced at once, by `minimal`.
"""

from __future__ import annotations

import argparse
import gc
import json
import resource
import statistics
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from immutables import Map

from midstride.model.best import best
from midstride.model.component import ComponentSpec, Connector, FunctionalitySpec, InputAlternatives, Mode
from midstride.model.configuration import Configuration
from midstride.model.contract import Predicate
from midstride.model.specification import Node, Specification, structure
from midstride.plan.change_builder import requested_change
from midstride.plan.plan import Plan
from midstride.plan.request import PlanRequest
from midstride.plan.strategies.registry import STRATEGIES

# `stop` replaces every node, so its cost does follow the size of the system.
NAMES = tuple(sorted(set(STRATEGIES) - {"stop"}))
SIZES = (1_000, 3_000, 10_000, 30_000, 100_000)
CELL = 5
TYPE = "std_msgs/msg/Header"
LIMIT_MS, LIMIT_RATIO, LIMIT_MIB = 50.0, 2.0, 1024.0
MANY, LIMIT_MANY_SECONDS = 1_000, 2.0


def component(name: str, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> ComponentSpec:
    work = FunctionalitySpec(
        "work",
        (
            Mode(
                "normal",
                tuple(InputAlternatives((port,)) for port in inputs),
                Map({o: Predicate(TYPE, 20.0) for o in outputs}),
            ),
            Mode("degraded"),
        ),
        inputs,
        outputs,
    )
    return ComponentSpec.of(
        name,
        inputs={port: Predicate(TYPE, 10.0) for port in inputs},
        outputs=outputs,
        functionalities=(work,),
        run=f"python3 {name.lower()}.py",
    )


def system(size: int) -> Specification:
    """``size`` components in cells of five."""
    components = [
        component("Sensor", (), ("out",)),
        component("Filter", ("in",), ("out",)),
        component("NewFilter", ("in",), ("out",)),
        component("User", ("in",), ("out",)),
        component("Sink", ("left", "right"), ()),
    ]
    nodes: dict[str, Node] = {}
    topics: dict[str, Connector] = {}
    for number in range(size // CELL):
        cell = f"cell{number}"
        raw, clean, left, right = (f"/{cell}/{name}" for name in ("raw", "clean", "left", "right"))
        for topic in (raw, clean, left, right):
            topics[topic] = Connector(topic, Predicate(TYPE, 10.0))
        for role, of, attachments in (
            ("sensor", "Sensor", {"out": (raw,)}),
            ("filter", "Filter", {"in": (raw,), "out": (clean,)}),
            ("one", "User", {"in": (clean,), "out": (left,)}),
            ("two", "User", {"in": (clean,), "out": (right,)}),
            ("sink", "Sink", {"left": (left,), "right": (right,)}),
        ):
            nodes[f"{cell}/{role}"] = Node(f"{cell}/{role}", of, Map(attachments))
    return Specification(
        "cells", connectors=Map(topics), components=Map({c.name: c for c in components}), nodes=Map(nodes)
    )


def peak_mib() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


@dataclass
class Case:
    """One size: the system, and the milliseconds that each strategy took for each replacement."""

    specification: Specification
    configuration: Configuration
    row: dict[str, Any]
    taken: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in NAMES})

    @classmethod
    def of(cls, size: int) -> Case:
        specification = system(size)
        bare = structure(specification)
        begin = time.perf_counter()
        configuration = best(bare)
        best_ms = (time.perf_counter() - begin) * 1000
        return cls(specification, configuration, {"components": len(specification.nodes), "best_ms": best_ms})

    def plan(self, strategy: str) -> Plan:
        """A whole replacement as the manager does it, from the request to the plan."""
        role = f"cell{len(self.specification.nodes) // CELL // 2}/filter"
        request = PlanRequest(replace=((role, "NewFilter"),), strategy=strategy)
        target = request.target(self.specification)
        return STRATEGIES[strategy](requested_change(self.configuration, self.specification, request, target))

    def replace_many(self, wanted: int, times: int) -> dict[str, Any]:
        """Replaces the filters of that many cells (or of all) in one change; seconds, and processor seconds."""
        roles = [f"cell{number}/filter" for number in range(min(wanted, len(self.specification.nodes) // CELL))]
        request = PlanRequest(replace=tuple((role, "NewFilter") for role in roles))
        taken, busy = [], []
        for _ in range(times):
            begin, cpu = time.perf_counter(), time.process_time()
            target = request.target(self.specification)
            plan = STRATEGIES["minimal"](requested_change(self.configuration, self.specification, request, target))
            taken.append(time.perf_counter() - begin)
            busy.append(time.process_time() - cpu)
        return {
            "components": len(self.specification.nodes),
            "replaced": len(roles),
            "median_seconds": statistics.median(taken),
            "median_processor_seconds": statistics.median(busy),
            "steps": len(plan.steps),
            "disruption": plan.disruption,
            "proved": plan.proved_minimal,
        }

    def conclude(self) -> dict[str, Any]:
        for name, taken in self.taken.items():
            plan = self.plan(name)
            self.row[name] = {
                "median_ms": statistics.median(taken),
                "p99_ms": sorted(taken)[int(0.99 * (len(taken) - 1))],
                "steps": len(plan.steps),
                "disruption": plan.disruption,
                "degraded": len(plan.degraded),
            }
        return self.row


def measure(sizes: list[int], times: int) -> list[Case]:
    """Every size and strategy in turn, round after round, so that what else the machine does meets all of them."""
    cases = [Case.of(size) for size in sizes]
    gc.collect()
    gc.freeze()  # as a manager that has long been running: the system itself is not looked at by each collection
    for turn in range(times + 1):
        for case in cases:
            for name in NAMES:
                begin = time.perf_counter()
                case.plan(name)
                if turn:  # the first is not warm
                    case.taken[name].append((time.perf_counter() - begin) * 1000)
    return cases


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--times", type=int, default=200, help="how often each replacement is planned")
    parser.add_argument("--times-many", type=int, default=5, help="how often the many are replaced at once")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "planning.json")
    options = parser.parse_args()

    cases = measure(sorted(options.sizes), options.times)
    rows = [case.conclude() for case in cases]
    print(f"{'components':>10} {'best, whole':>12} " + " ".join(f"{f'{name}: median, p99':>24}" for name in NAMES))
    for row in rows:
        told = " ".join(f"{row[name]['median_ms']:10.2f} {row[name]['p99_ms']:10.2f} ms" for name in NAMES)
        print(f"{row['components']:>10,} {row['best_ms']:>9.1f} ms {told}")

    many = cases[-1].replace_many(MANY, options.times_many)
    print(
        f"{many['replaced']:,} replaced at once among {many['components']:,}: median {many['median_seconds']:.2f} s"
        f" ({many['median_processor_seconds']:.2f} s of the processor), {many['steps']:,} steps"
    )

    smallest, largest = cases[0].taken, cases[-1].taken
    ratios = {
        name: statistics.median(b / a for a, b in zip(smallest[name], largest[name], strict=True)) for name in NAMES
    }
    verdict = {
        "largest_within_50_ms": max(rows[-1][name]["median_ms"] for name in NAMES) <= LIMIT_MS,
        "within_2x_of_smallest": max(ratios.values()) <= LIMIT_RATIO,
        "many_within_2_s": many["median_seconds"] <= LIMIT_MANY_SECONDS,
        "peak_under_1_gib": peak_mib() < LIMIT_MIB,
    }
    print("the largest against the smallest: " + ", ".join(f"{name} {ratio:.2f}x" for name, ratio in ratios.items()))
    print(f"peak memory, all sizes at once: {peak_mib():.0f} MiB")
    print(", ".join(f"{name.replace('_', ' ')}: {'yes' if held else 'NO'}" for name, held in verdict.items()))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    document = {"rows": rows, "many": many, "ratios": ratios, "peak_mib": peak_mib(), "verdict": verdict}
    options.out.write_text(json.dumps(document, indent=2) + "\n")
    print(f"written to {options.out}")
    return 0 if all(verdict.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
