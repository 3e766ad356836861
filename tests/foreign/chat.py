"""The system of the tests: a talker, another one that can replace it, and a listener, all without Midstride's API."""

from __future__ import annotations


def chat(gate: str, *, talker: str = "", listener: str = "") -> str:
    """In Stride. ``talker``: lines of its declaration besides; ``listener``: what its input states besides."""
    return f"""system chat

topic /chat : std_msgs/msg/String @ 50 Hz {{ publishers <= 1 }}

component Talker {{
  run "talker" gate {gate}
  {talker}
  output out as chatter
  functionality talk {{
    produces out
    mode normal {{ guarantee out : std_msgs/msg/String @ 50 Hz }}
    mode degraded {{ }}
  }}
}}

component Other like Talker {{ run "other" gate {gate} }}

component Listener {{
  run "listener" gate {gate}
  input in : std_msgs/msg/String @ 50 Hz {listener} as chatter
  functionality listen {{
    uses in
    mode normal {{ assume in }}
    mode degraded {{ }}
  }}
}}

node talker   : Talker   {{ out -> /chat }}
node listener : Listener {{ in <- /chat }}
"""
