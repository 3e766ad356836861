"""The vocabulary: every command there is, with its arguments and its result.

Times on the wire are integers of nanoseconds on the ROS clock; durations are floats of seconds.
A "gate" stands in front of each attached output: ``closed`` counts and type-checks what the
component writes and passes nothing on, ``open`` passes it on.

Reading (no revision needed, nothing changes):

``observe``       {} -> State (below)
``grid``          {port} -> {"trigger": "rate"|"message"|"none", "epoch": ns|None, "period": s|None, "now": ns}; the
                  time grid of the mode that drives the output: slot n is at epoch + n * period
``records``       {input} -> {"rows": [[received ns (steady), source ns|None, number|None, publisher|None], ...],
                  "publisher_identity": bool, "now": ns (steady)}
``export_state``  {} -> {"state": base64 | None}
``await_write``   {port, topic, timeout} -> {"gated": n, "wrong_type": null | words}; waits for a write behind the gate
``await_cut``     {cut, timeout} -> CutEnd; waits until this side of the cut is over
``ping``          {} -> {}

Changing (with the expected revision):

``welcome``       {manager} -> State; the component stops announcing itself
``attach``        {port, topic, gate: "open"|"closed", peers: n, timeout} -> {}; creates the endpoint, waits until at
                  least ``peers`` compatible endpoints are matched and settled, and only then opens the gate
``detach``        {port, topic, timeout} -> {"acknowledged": bool|None, "last": n|None}; gate closed, drained,
                  endpoint destroyed; ``last`` is the number of an output's last message there
``modes``         {modes: {functionality: mode}, timeout, because} -> {"from": {functionality: mode}}; takes effect
                  between two calls of user code; refused (and taken back) if a call does not return in time
``set``           {parameters: {name: value}} -> {"from": {name: value}}
``import_state``  {state: base64} -> {}
``record``        {inputs: [...], on: bool} -> {"now": ns (steady)}; an input always keeps its last 64 receipts, and
                  all of them while this is on
``meet``          {peer} -> {}; makes sure the component can call its peer of a hand-over (a `ping` answered)
``cut_out``       {cut, swaps: [{port, topic}], at: ns, resume_after: s} -> {}; the old side: writes up to ``at``, then
                  its gates close; they open again if it does not hear ``taken`` within ``resume_after`` after ``at``
                  (a message-driven output: after the first input newer than ``at``: before, nothing was to be written)
``cut_in``        {cut, swaps: [{port, topic, latch: bool}], at: ns, epoch: ns|None, peer} -> {}; the new side: its
                  (closed) gates open at ``at``; a rate-driven mode takes up the grid of ``epoch``; tells ``taken`` to
                  its peer after its first write; ``latch``: writes the last gated message again at ``at``
``cancel_cut``    {cut} -> {}; the old side's gates stay or become open, the new side's closed
``gate``          {port, topic, gate} -> {}
``release``       {timeout} -> {}; one that was started by hand belongs to nobody again: every functionality goes to its
                  last mode, every port is detached, and it announces itself as at first
``stop``          {} -> {}; ends the process in order

Between components (by the token of the system, no revision):

``taken``         {cut} -> {"resumed": bool}; the new side has written. True: too late, the old side writes again

CutEnd, old side: {"outcome": "done"|"resumed"|"cancelled"|"waiting", "last": {port topic: [number, source ns | None]
| None}}; "done" once it has passed ``at`` and heard ``taken``; the source is None where it has not written since it was
told of the cut. New side: {"outcome": "done"|"cancelled"|"waiting", "first": {port topic: [number, source ns] | None}}.
"waiting": not over within the time-out. Where one component is both sides, both are told in one. Keys are "port topic"
with a space between.

State: {"instance", "uuid", "pid", "revision", "functionalities": {name: {"mode", "since": s ago, "because",
"busy": s | None}}, "ports": {port: {topic: {"gate": "open"|"closed"|None, "count": n, "gated": n}}},
"parameters": {name: value}, "waiting": words | None, "stopping": s, how long it may take to end in order}
"""

from __future__ import annotations

from typing import Final

READING: Final = frozenset({"observe", "grid", "records", "export_state", "await_write", "await_cut", "ping"})
CHANGING: Final = frozenset(
    {
        "welcome",
        "attach",
        "detach",
        "modes",
        "set",
        "import_state",
        "record",
        "meet",
        "cut_out",
        "cut_in",
        "cancel_cut",
        "gate",
        "release",
        "stop",
    }
)
BETWEEN: Final = frozenset({"taken"})
