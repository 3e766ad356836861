"""Large systems as specification texts."""

from __future__ import annotations


def chain(nodes: int) -> str:
    """A system of that many nodes, each fed by the one before, with ten kinds of components."""
    parts = ["system large\n", "contract Data = std_msgs/msg/String @ 10 Hz\n", "environment {\n"]
    parts += ["  guarantee source on /t0 : std_msgs/msg/String @ 50 Hz\n}\n"]
    for kind in range(10):
        parts.append(
            f"""component Filter{kind} {{
  run "python3 -m filters.f{kind}"
  parameters {{ changeable gain = {kind}.5, name = "f{kind}" }}
  input  in : Data
  output out
  functionality filter weight {kind + 1} {{
    uses in
    produces out
    mode normal {{ assume in   guarantee out : std_msgs/msg/String @ 20 Hz }}
    mode slow   {{ assume Data   guarantee out : std_msgs/msg/String @ 10 Hz }}
    mode off {{ }}
  }}
}}
"""
        )
    parts += [f"topic /t{n} : Data\n" for n in range(nodes + 1)]
    parts += [
        f"node n{n} : Filter{n % 10} {{ in <- /t{n}   out -> /t{n + 1}   parameters {{ gain = {n}.0 }} }}\n"
        for n in range(nodes)
    ]
    parts += [f"keep n{n}.filter at slow\n" for n in range(0, nodes, 10)]
    return "".join(parts)
