"""A comparison of ways to replace a ROS node that publishes: the gap, and what is lost, doubled and out of order.

`python benchmarks/swap` measures and reports; docs/swap-comparison.md says how, and how to add a way.
"""
