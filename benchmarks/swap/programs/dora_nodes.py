"""The nodes of a dataflow of Dora: a source that is replaced, and a recorder."""

from __future__ import annotations

import json
import sys
import time

from content import HEAD, counted, read


def source(size: str) -> None:
    """Sends bytes whenever Dora's timer ticks."""
    import pyarrow
    from dora import Node

    node, following = Node(), counted("dora", int(size))
    for event in node:
        if event["type"] == "INPUT":
            text = following().encode()
            buffers = [None, pyarrow.py_buffer(text)]
            node.send_output("out", pyarrow.UInt8Array.from_buffers(pyarrow.uint8(), len(text), buffers))
        elif event["type"] == "STOP":
            break


def recorder(path: str) -> None:
    """A line for each message in ``path``, as the recorders on ROS have them."""
    from dora import Node

    node = Node()
    with open(path, "w", encoding="utf-8", buffering=1) as file:
        for event in node:
            if event["type"] == "INPUT":
                received = time.monotonic_ns()
                print(json.dumps([received, *read(bytes(event["value"][:HEAD].to_pylist()))]), file=file)
            elif event["type"] == "STOP":
                break


if __name__ == "__main__":
    {"source": source, "recorder": recorder}[sys.argv[1]](*sys.argv[2:])
