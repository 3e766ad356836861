"""The proof of least disruption on 100 hard changes: 60 actions tied together, among 200 functionalities.

For each change of the published set (``_conflict_core_systems``): how long the planner takes to its proof, or how far
the plan may be from the least after the time given; the same of a plain A* over the sets of done actions, with the same
memoised fixed point and each role's own least absence as its bound, but without independent parts, without the bound of
what has to make room, and without a plan to begin with; and, if asked for, of clingo on the logic program of the tests.
Times and limits are those of the processor, so that other load on the machine makes no difference. The results are
written after each change; ``--resume`` goes on from them.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import resource
import statistics
import sys
import time
from collections.abc import Callable
from math import inf
from pathlib import Path
from typing import Any, Final

from _conflict_core_systems import SEEDS, instance
from _guard import guard

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from midstride.model.specification import initial  # noqa: E402
from midstride.plan.change import Change  # noqa: E402
from midstride.plan.change_builder import change_between  # noqa: E402
from midstride.plan.core.conflict_core import Part, Topic, parts  # noqa: E402
from midstride.plan.core.core_bounds import RoleBounds  # noqa: E402
from midstride.plan.core.core_losses import PartLosses, fullest  # noqa: E402
from midstride.plan.core.core_plan import Budget  # noqa: E402
from midstride.plan.core.core_search import PartResult, PartSearch  # noqa: E402
from midstride.plan.disruption import Levels  # noqa: E402
from midstride.plan.strategies.minimal import minimal  # noqa: E402
from tests.replay.plan_replay import replay  # noqa: E402


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
    search = PartSearch(part, PartLosses(change, part, Levels(change), fullest(change)), {}, ends=False)
    search.bounds = OwnAbsences(part, search.losses)
    result = search.run(Budget(inf, seconds, time.process_time).is_used_up, PartResult(0.0))
    return {"proved": result.cost < inf, "seconds": time.process_time() - begin, "bound": result.lower_bound}


def _solve(seed: int, seconds: float) -> None:
    """Ends with status 0 if the least disruption is proved; the system ends it when its time is up."""
    from tests.plan.answer_sets import AnswerSets

    change = changed(seed)
    most = math.ceil(time.process_time() + seconds)
    resource.setrlimit(resource.RLIMIT_CPU, (most, most + 1))
    AnswerSets(change).optimum()


def clingo(seed: int, seconds: float) -> dict[str, Any]:
    """In a separate process: grounding cannot be interrupted. The time counts from the start of that process."""
    before = seconds_of_children()
    process = multiprocessing.get_context("spawn").Process(target=_solve, args=(seed, seconds))
    process.start()
    process.join()
    return {"proved": process.exitcode == 0, "seconds": seconds_of_children() - before}


def seconds_of_children() -> float:
    """The processor time (s) of the processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


WAYS: Final[dict[str, Callable[[int, Change, float], dict[str, Any]]]] = {
    "minimal": lambda _, change, seconds: planned(change, seconds),
    "plain": lambda _, change, seconds: plain(change, seconds),
    "clingo": lambda seed, _, seconds: clingo(seed, seconds),
}


def judged(row: dict[str, Any], way: str) -> str:
    """One way's result in words. Two proofs that disagree end the benchmark."""
    found = row[way]
    if found["proved"] and row.get("minimal", {}).get("proved") and "disruption" in found:
        assert abs(found["disruption"] - row["minimal"]["disruption"]) < 1e-6, f"seed {row['seed']}"
    if found["proved"]:
        return f"{way} {found['seconds']:.2f} s"
    bound = f", bound {found['bound']:.2f}" if "bound" in found else ""
    return f"{way} no proof in {found['seconds']:.2f} s{bound}"


def summary(rows: list[dict[str, Any]], seconds: float) -> dict[str, bool]:
    """Prints what each way has proved. Returns what the issue asks for, and whether it holds."""
    for way in WAYS:
        found = [row[way] for row in rows if way in row]
        proved = [each["seconds"] for each in found if each["proved"]]
        median = f", median {statistics.median(proved):.2f} s" if proved else ""
        if found:
            print(f"{way}: {len(proved)} of {len(found)} proved within {seconds:g} s{median}")
    verdict: dict[str, bool] = {}
    if ours := [row["minimal"] for row in rows if "minimal" in row]:
        gaps = [each["gap"] for each in ours if not each["proved"]]
        print(f"gap of the others: {', '.join(f'{gap:.0%}' for gap in gaps) or 'none'}")
        verdict["proved_in_90_percent"] = sum(each["proved"] for each in ours) >= 0.9 * len(ours)
        verdict["others_within_20_percent"] = all(gap <= 0.2 for gap in gaps)
    if others := [row["plain"] for row in rows if "plain" in row]:
        verdict["plain_fails_on_half"] = sum(not each["proved"] for each in others) >= len(others) / 2
    print(", ".join(f"{name.replace('_', ' ')}: {'yes' if held else 'NO'}" for name, held in verdict.items()))
    return verdict


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0, help="for each change and each way")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(SEEDS))
    parser.add_argument("--ways", choices=list(WAYS), nargs="+", default=["minimal", "plain"])
    parser.add_argument("--resume", action="store_true", help="leave out what the file of results has already")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "conflict_cores.json")
    options = parser.parse_args()
    guard()

    options.out.parent.mkdir(parents=True, exist_ok=True)
    rows: dict[int, dict[str, Any]] = {}
    if options.resume and options.out.exists():
        rows = {row["seed"]: row for row in json.loads(options.out.read_text())["rows"]}
    for seed in options.seeds:
        change = changed(seed)
        separate = parts(change, ())
        row = rows.setdefault(seed, {"seed": seed})
        row |= {"tied": sum(len(part.ops) for part in separate), "parts": len(separate)}
        for way in options.ways:
            if way not in row:
                row[way] = WAYS[way](seed, change, options.seconds)
        words = "; ".join(judged(row, way) for way in WAYS if way in row)
        print(f"{seed:>3}  {row['tied']} tied in {row['parts']} parts: {words}", flush=True)
        options.out.write_text(json.dumps({"rows": [rows[each] for each in sorted(rows)]}, indent=2) + "\n")

    verdict = summary([rows[each] for each in sorted(rows)], options.seconds)
    document = {"rows": [rows[each] for each in sorted(rows)], "verdict": verdict}
    options.out.write_text(json.dumps(document, indent=2) + "\n")
    return 0 if all(verdict.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
