"""For users and for Midstride's own tests: hypothesis strategies over the model, and more.

`strategies` needs the package `hypothesis`; nothing else of Midstride does.
"""
