"""The proof of least disruption on 100 hard changes: 60 actions tied together, among 200 functionalities.

For each change of the published set (``_conflict_core_systems``): how long the planner takes to its proof, or how far
the plan may be from the least after the time given; the same of a plain A* over the sets of done actions, with the same
memoised fixed point and each role's own least absence as its bound, but without independent parts, without the bound of
what has to make room, and without a plan to begin with; and, if asked for, of clingo on the logic program of the tests,
and of CP-SAT (one worker, ``_conflict_core_cpsat``; needs ``ortools``, which nothing else here does). Times are those
of the processor, so that what else the machine does makes no difference (clingo's are the clock's).
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import statistics
import sys
import time
from math import inf
from pathlib import Path
from typing import Any

from _conflict_core_systems import SEEDS, instance

from midstride.model.specification import initial
from midstride.plan.change import Change
from midstride.plan.change_builder import change_between
from midstride.plan.core import Part, Topic, parts
from midstride.plan.core_bounds import RoleBounds
from midstride.plan.core_losses import PartLosses, fullest
from midstride.plan.core_plan import Budget
from midstride.plan.core_search import PartResult, PartSearch
from midstride.plan.disruption import Levels
from midstride.plan.minimal import minimal
from midstride.plan.validate import replay


class OwnAbsences(RoleBounds):
    """Each role's own least absence, and nothing about room."""

    def _loss_with_room(self, place: int, own: int, bit: int) -> float:
        return self._loss(place, own)

    def _least_absences(self, state: int, resource: int) -> float:
        return 0.0


def together(separate: list[Part]) -> Part:
    """One part that has the actions of all."""
    whole = Part(())
    for part in separate:
        shift, before = len(whole.ops), len(whole.free)
        whole = Part(
            ops=(*whole.ops, *part.ops),
            roles=(*whole.roles, *part.roles),
            seconds=(*whole.seconds, *part.seconds),
            usage=(
                *((*usage, *(0,) * len(part.free)) for usage in whole.usage),
                *((*(0,) * before, *usage) for usage in part.usage),
            ),
            free=(*whole.free, *part.free),
            topics=(*whole.topics, *(Topic(t.free, t.attach << shift, t.detach << shift) for t in part.topics)),
            live=(*whole.live, *(bits << shift for bits in part.live)),
            after=(*whole.after, *(bits << shift for bits in part.after)),
            of_instance={**whole.of_instance, **{name: bits << shift for name, bits in part.of_instance.items()}},
        )
    return whole


def changed(seed: int) -> Change:
    start, target = instance(seed)
    return change_between(initial(start), start, target)


def planned(change: Change, seconds: float) -> dict[str, Any]:
    begin = time.process_time()
    plan = minimal(change, Budget(inf, seconds, time.process_time))
    taken = time.process_time() - begin
    assert replay(plan).holds
    gap = 0.0 if plan.proved_minimal else 1 - plan.lower_bound / plan.disruption
    return {
        "proved": plan.proved_minimal and taken <= seconds,
        "seconds": taken,
        "disruption": plan.disruption,
        "bound": plan.lower_bound,
        "gap": gap,
    }


def plain(change: Change, seconds: float) -> dict[str, Any]:
    begin = time.process_time()
    part = together(parts(change, ()))
    search = PartSearch(part, PartLosses(change, part, Levels(change), fullest(change)), {})
    search.bounds = OwnAbsences(part, search.losses)
    result = search.run(Budget(inf, seconds, time.process_time).is_used_up, PartResult(0.0))
    return {"proved": result.cost < inf, "seconds": time.process_time() - begin, "bound": result.lower_bound}


def _solve(seed: int) -> None:
    sys.path.insert(0, str(Path(__file__).parents[1]))
    from tests.plan.answer_sets import AnswerSets

    AnswerSets(changed(seed)).optimum()


def clingo(seed: int, seconds: float) -> dict[str, Any]:
    """In a process of its own: grounding cannot be interrupted."""
    begin = time.perf_counter()
    process = multiprocessing.get_context("spawn").Process(target=_solve, args=(seed,))
    process.start()
    process.join(seconds)
    proved = process.exitcode == 0
    process.kill()
    process.join()
    return {"proved": proved, "seconds": time.perf_counter() - begin}


def cpsat(change: Change, seconds: float) -> dict[str, Any]:
    """It counts the clock, so it is given twice the time, of which the processor's counts as for the others."""
    from _conflict_core_cpsat import solve

    begin = time.process_time()
    proved, best, bound = solve(change, 2 * seconds)
    taken = time.process_time() - begin
    return {"proved": proved and taken <= seconds, "seconds": taken, "disruption": best, "bound": bound}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0, help="for each change and each way")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(SEEDS))
    parser.add_argument("--skip-plain", action="store_true", help="without the plain A*, which takes most of the time")
    parser.add_argument("--clingo", action="store_true", help="needs clingo; most of the time goes into it")
    parser.add_argument("--cpsat", action="store_true", help="needs ortools")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "conflict_cores.json")
    options = parser.parse_args()

    rows: list[dict[str, Any]] = []
    for seed in options.seeds:
        change = changed(seed)
        separate = parts(change, ())
        row: dict[str, Any] = {"seed": seed, "tied": sum(len(part.ops) for part in separate), "parts": len(separate)}
        row["minimal"] = planned(change, options.seconds)
        if not options.skip_plain:
            row["plain"] = plain(change, options.seconds)
        if options.clingo:
            row["clingo"] = clingo(seed, options.seconds)
        if options.cpsat:
            row["cpsat"] = cpsat(change, options.seconds)
            if row["cpsat"]["proved"] and row["minimal"]["proved"]:
                assert abs(row["cpsat"]["disruption"] - row["minimal"]["disruption"]) < 1e-6, f"seed {seed}"
        rows.append(row)
        ours, other = row["minimal"], row.get("plain")
        print(
            f"{seed:>3}  {row['tied']} tied in {row['parts']} parts  disruption {ours['disruption']:8.2f}  "
            + (f"proved in {ours['seconds']:5.2f} s" if ours["proved"] else f"at least {ours['bound']:8.2f}")
            + (
                f"  plain A*: {'proved' if other['proved'] else 'no proof'} in {other['seconds']:5.2f} s"
                if other
                else ""
            ),
            flush=True,
        )

    for way in (way for way in ("minimal", "plain", "clingo", "cpsat") if way in rows[0]):
        proved = [row[way]["seconds"] for row in rows if row[way]["proved"]]
        median = f", median {statistics.median(proved):.2f} s" if proved else ""
        print(f"{way}: {len(proved)} of {len(rows)} proved within {options.seconds:g} s{median}")
    gaps = [row["minimal"]["gap"] for row in rows if not row["minimal"]["proved"]]
    print(f"gap of the others: {', '.join(f'{gap:.0%}' for gap in gaps) or 'none'}")
    verdict = {
        "proved_in_90_percent": sum(row["minimal"]["proved"] for row in rows) >= 0.9 * len(rows),
        "others_within_20_percent": all(gap <= 0.2 for gap in gaps),
    }
    if not options.skip_plain:
        verdict["plain_fails_on_half"] = sum(not row["plain"]["proved"] for row in rows) >= len(rows) / 2
    print(", ".join(f"{name.replace('_', ' ')}: {'yes' if held else 'NO'}" for name, held in verdict.items()))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps({"rows": rows, "verdict": verdict}, indent=2) + "\n")
    return 0 if all(verdict.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
