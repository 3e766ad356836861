"""Five faults of rate, type and QoS: what `midstride check` finds, where it points, how long it takes.

`play_launch check` beside it: on PyPI, it checks contract files that lie beside launch files. Its program needs the
libraries of an installed ROS 2 even for `check`. It is run by the command in the environment variable PLAY_LAUNCH
(else `play_launch`); where that does not run, the table says so and why.

Both check the same three nodes, with one fault planted at a time; what counts as found is an error on account of the
fault, and nothing else beside it. The time is that of the whole command, the median of the runs.

Then `midstride check` of large systems, beside what starting the interpreter costs (`python -c pass`): the processor
time of the whole command, start-up included, in interleaved runs.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT))

from tests.large_systems import chain  # noqa: E402

RESULTS = ROOT / "benchmarks" / "results" / "check.json"

STRIDE = """system robot

topic /scan      : sensor_msgs/msg/LaserScan @ 10 Hz
topic /obstacles : sensor_msgs/msg/Range @ 10 Hz

component Sensor {
  output out
  functionality sense {
    produces out
    mode normal { guarantee out : sensor_msgs/msg/LaserScan @ 10 Hz }
    mode off { }
  }
}

component Detector {
  input  scan : sensor_msgs/msg/LaserScan @ 10 Hz
  output out
  functionality detect {
    uses scan
    produces out
    mode normal { assume scan   guarantee out : sensor_msgs/msg/Range @ 10 Hz }
    mode off { }
  }
}

component Controller {
  input obstacles : sensor_msgs/msg/Range @ 5 Hz
  functionality control {
    uses obstacles
    mode normal { assume obstacles }
    mode off { }
  }
}

node sensor     : Sensor     { out -> /scan }
node detector   : Detector   { scan <- /scan   out -> /obstacles }
node controller : Controller { obstacles <- /obstacles }
"""

LAUNCH = """<launch>
  <node pkg="robot" exec="sensor" name="sensor"><remap from="out" to="/scan"/></node>
  <node pkg="robot" exec="detector" name="detector">
    <remap from="scan" to="/scan"/>
    <remap from="out" to="/obstacles"/>
  </node>
  <include file="$(dirname)/control.launch.xml"/>
</launch>
"""
INCLUDED = """<launch>
  <node pkg="robot" exec="controller" name="controller"><remap from="obstacles" to="/obstacles"/></node>
</launch>
"""
CONTRACT = """version: 1
nodes:
  sensor:
    pub:
      out: {min_rate_hz: 10, qos: {reliability: reliable, durability: volatile}}
  detector:
    sub:
      scan: {min_rate_hz: 10, qos: {reliability: reliable, durability: volatile}}
    pub:
      out: {min_rate_hz: 10}
topics:
  /scan:
    type: sensor_msgs/msg/LaserScan
    pub: [sensor/out]
    sub: [detector/scan]
    rate_hz: 10
    qos: {reliability: reliable, durability: volatile, depth: 10}
  /obstacles:
    type: sensor_msgs/msg/Range
    pub: [detector/out]
    rate_hz: 10
    qos: {reliability: reliable, durability: volatile, depth: 10}
"""
CONTROL = """version: 1
nodes:
  controller:
    sub:
      obstacles: {min_rate_hz: 5, qos: {reliability: reliable, durability: volatile}}
topics:
  /obstacles:
    type: sensor_msgs/msg/Range
    sub: [controller/obstacles]
    rate_hz: 10
    qos: {reliability: reliable, durability: volatile, depth: 10}
"""


@dataclass(frozen=True)
class Fault:
    """A change of the sound files. ``words`` must stand in a finding for it to be about this fault."""

    name: str
    stride: tuple[str, str]
    contract: tuple[str, str]
    words: tuple[str, ...]


FAULTS = (
    Fault(
        "a subscriber needs 20 Hz of a topic of 10 Hz",
        ("input  scan : sensor_msgs/msg/LaserScan @ 10 Hz", "input  scan : sensor_msgs/msg/LaserScan @ 20 Hz"),
        ("scan: {min_rate_hz: 10", "scan: {min_rate_hz: 20"),
        ("rate", "20"),
    ),
    Fault(
        "a publisher gives 5 Hz to a topic of 10 Hz",
        ("guarantee out : sensor_msgs/msg/Range @ 10 Hz", "guarantee out : sensor_msgs/msg/Range @ 5 Hz"),
        ("pub:\n      out: {min_rate_hz: 10}", "pub:\n      out: {min_rate_hz: 5}"),
        ("rate", "5"),
    ),
    Fault(
        "a subscriber expects another message type",
        ("input obstacles : sensor_msgs/msg/Range", "input obstacles : sensor_msgs/msg/PointCloud2"),
        ("type: sensor_msgs/msg/Range\n    sub", "type: sensor_msgs/msg/PointCloud2\n    sub"),
        ("PointCloud2",),
    ),
    Fault(
        "best effort is offered, reliable is needed",
        (
            "topic /scan      : sensor_msgs/msg/LaserScan @ 10 Hz",
            "topic /scan      : sensor_msgs/msg/LaserScan @ 10 Hz qos(reliability = best_effort)",
        ),
        (
            "out: {min_rate_hz: 10, qos: {reliability: reliable,",
            "out: {min_rate_hz: 10, qos: {reliability: best_effort,",
        ),
        ("reliab",),
    ),
    Fault(
        "volatile is offered, transient local is needed",
        (
            "input obstacles : sensor_msgs/msg/Range @ 5 Hz",
            "input obstacles : sensor_msgs/msg/Range @ 5 Hz qos(durability = transient_local)",
        ),
        (
            "obstacles: {min_rate_hz: 5, qos: {reliability: reliable, durability: volatile",
            "obstacles: {min_rate_hz: 5, qos: {reliability: reliable, durability: transient_local",
        ),
        ("durability",),
    ),
)


@dataclass
class Answer:
    findings: list[dict[str, Any]]
    seconds: float
    failure: str = ""


def run(command: list[str], folder: Path, runs: int) -> tuple[str, str, float]:
    taken = []
    for _ in range(runs):
        start = time.perf_counter()
        done = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL
        )
        taken.append(time.perf_counter() - start)
    return done.stdout, done.stderr, statistics.median(taken)


def midstride(folder: Path, text: str, runs: int) -> Answer:
    (folder / "robot.stride").write_text(text)
    out, _, seconds = run([sys.executable, "-m", "midstride", "check", "robot.stride", "--json"], folder, runs)
    found = [d for d in json.loads(out)["diagnostics"] if d["severity"] == "error"]
    return Answer(
        [{"where": f"{d['file']}:{d['line']}:{d['column']}", "what": d["message"], "code": d["code"]} for d in found],
        seconds,
    )


def play_launch(folder: Path, contract: str, control: str, runs: int) -> Answer:
    files = {
        "robot.launch.xml": LAUNCH,
        "control.launch.xml": INCLUDED,
        "robot.contract.yaml": contract,
        "control.contract.yaml": control,
    }
    for name, text in files.items():
        (folder / name).write_text(text)
    command = [
        *shlex.split(os.environ.get("PLAY_LAUNCH", "play_launch")),
        "check",
        "robot.launch.xml",
        "--format",
        "json",
    ]
    try:
        out, err, seconds = run(command, folder, runs)
    except OSError as error:
        return Answer([], 0.0, f"{command[0]}: {error.strerror}")
    if not out.strip():
        return Answer([], 0.0, (err.strip().splitlines() or ["it says nothing"])[-1])
    found: list[dict[str, Any]] = []
    at, decoder = 0, json.JSONDecoder()
    while at < len(out.rstrip()):  # one document for each contract file, then one across all
        document, at = decoder.raw_decode(out, at + len(out[at:]) - len(out[at:].lstrip()))
        found += document
    return Answer([_finding(entry, folder) for entry in found if entry["severity"] == "error"], seconds)


def _finding(entry: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Its place as line and column, where it gives one: it counts characters of the contract file."""
    where = entry["path"]
    if entry.get("span") and entry.get("contract_path"):
        before = Path(entry["contract_path"]).read_text()[: entry["span"]["start"]]
        line, column = before.count("\n") + 1, len(before) - before.rfind("\n")
        where = f"{Path(entry['contract_path']).name}:{line}:{column}"
    return {"where": where, "what": entry["message"], "code": entry["rule"]}


def judge(answer: Answer, fault: Fault | None) -> str:
    if answer.failure:
        return "not run"
    if fault is None:
        return "nothing" if not answer.findings else f"{len(answer.findings)} false"
    about = [f for f in answer.findings if all(word in f["what"] for word in fault.words)]
    others = len(answer.findings) - len(about)
    if not about:
        return "missed"
    return (
        "found"
        + (f", told {len(about)} times" if len(about) > 1 else "")
        + (f", and {others} others" if others else "")
    )


def processor_seconds(command: list[str]) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def by_size(sizes: list[int], runs: int) -> list[dict[str, float]]:
    """For each number of nodes, the median processor time in seconds, and as a multiple of an empty program's."""
    rows: list[dict[str, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        for nodes in sizes:
            file = Path(folder) / f"{nodes}.stride"
            file.write_text(chain(nodes))
            checks, empties = [], []
            for _ in range(runs):
                checks.append(processor_seconds([sys.executable, "-m", "midstride", "check", str(file)]))
                empties.append(processor_seconds([sys.executable, "-c", "pass"]))
            seconds, empty = statistics.median(checks), statistics.median(empties)
            rows.append({"nodes": nodes, "seconds": round(seconds, 3), "times empty": round(seconds / empty, 1)})
    return rows


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--nodes", type=int, nargs="+", default=[100, 1_000, 10_000])
    parser.add_argument("--out", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for fault in (None, *FAULTS):
        stride, contract, control = STRIDE, CONTRACT, CONTROL
        if fault is not None:
            assert fault.stride[0] in stride
            assert (fault.contract[0] in contract) != (fault.contract[0] in control)
            stride = stride.replace(*fault.stride)
            contract, control = contract.replace(*fault.contract), control.replace(*fault.contract)
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            answers = {
                "midstride": midstride(folder, stride, arguments.runs),
                "play_launch": play_launch(folder, contract, control, arguments.runs),
            }
        row: dict[str, Any] = {"fault": fault.name if fault else "none"}
        print(f"\n{row['fault']}")
        for tool, answer in answers.items():
            verdict = judge(answer, fault)
            row[tool] = {
                "verdict": verdict,
                "milliseconds": round(answer.seconds * 1000, 1),
                "findings": answer.findings,
                "failure": answer.failure,
            }
            time_ = f"{answer.seconds * 1000:6.0f} ms" if not answer.failure else f"({answer.failure})"
            print(f"  {tool:12} {verdict:28} {time_}")
            for finding in answer.findings:
                print(f"      {finding['where']}: {finding['what']}")
        rows.append(row)
    arguments.out.parent.mkdir(exist_ok=True)
    sizes = by_size(arguments.nodes, arguments.runs)
    arguments.out.write_text(json.dumps({"runs": arguments.runs, "rows": rows, "sizes": sizes}, indent=1) + "\n")
    print(f"\n{'fault':50} {'midstride':>28} {'play_launch':>34}")
    for row in rows:
        told = [f"{row[tool]['verdict']} {row[tool]['milliseconds']:.0f} ms" for tool in ("midstride", "play_launch")]
        print(f"{row['fault']:50} {told[0]:>28} {told[1]:>34}")
    print(f"\n{'nodes':>8} {'check, processor time':>24} {'of an empty program':>22}")
    for size in sizes:
        print(f"{size['nodes']:8,.0f} {size['seconds']:22.3f} s {size['times empty']:20.1f} x")
    return 0 if all(row["midstride"]["verdict"] in {"found", "nothing"} for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
