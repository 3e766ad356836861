"""Generates text from a specification: drawings, node skeletons, launch and package files. Performs no I/O."""

PUBLIC = "GeneratedFile Merged digest merge_component merge_copy merge_whole project to_dot to_mermaid view"
