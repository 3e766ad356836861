"""One HTML file of a change, or of a plan before it: self-contained, to be attached to a bug report or a paper."""

PUBLIC = "change_file inlined plan_file"
