"""Generates text from a specification: drawings, node skeletons, launch and package files. Performs no I/O."""
