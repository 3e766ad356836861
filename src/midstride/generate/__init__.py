"""From a specification to text: drawings, skeletons of nodes, launch and package files.

Pure: no file is touched here.
"""
