"""ROS's own parser of parameters (librcl_yaml_param_parser): of files, and of the arguments of a node's process.

It is called without a process or a node.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

LIBRARY: Final = "librcl_yaml_param_parser.so"


class _Allocator(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("allocate", "free", "reallocate", "zero_allocate", "state")]


def _array(member: Any) -> Any:
    """A pointer to the struct of an array with members of a C type."""
    fields = [("values", ctypes.POINTER(member)), ("size", ctypes.c_size_t)]
    return ctypes.POINTER(type(f"Array_{member.__name__}", (ctypes.Structure,), {"_fields_": fields}))


class _Strings(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("data", ctypes.POINTER(ctypes.c_char_p)), ("allocator", _Allocator)]


class _Variant(ctypes.Structure):
    _fields_ = [
        ("bool", ctypes.POINTER(ctypes.c_bool)),
        ("integer", ctypes.POINTER(ctypes.c_int64)),
        ("double", ctypes.POINTER(ctypes.c_double)),
        ("string", ctypes.c_char_p),
        ("bytes", _array(ctypes.c_uint8)),
        ("bools", _array(ctypes.c_bool)),
        ("integers", _array(ctypes.c_int64)),
        ("doubles", _array(ctypes.c_double)),
        ("strings", ctypes.POINTER(_Strings)),
    ]


class _NodeParameters(ctypes.Structure):
    _fields_ = [
        ("names", ctypes.POINTER(ctypes.c_char_p)),
        ("values", ctypes.POINTER(_Variant)),
        ("count", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
    ]


class _Parameters(ctypes.Structure):
    _fields_ = [
        ("nodes", ctypes.POINTER(ctypes.c_char_p)),
        ("parameters", ctypes.POINTER(_NodeParameters)),
        ("count", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    ]


@lru_cache(maxsize=1)
def rcl_parser() -> Any | None:
    """The library of ROS; None where it cannot be loaded."""
    folders = [os.path.join(sys.prefix, "lib"), *os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)]
    try:
        import rclpy  # noqa: F401  # loads the libraries of the wheels, wherever they are

        with open("/proc/self/maps", encoding="utf-8") as maps:
            folders += [os.path.dirname(line.split()[-1]) for line in maps if "librcutils.so" in line]
    except (ImportError, OSError):
        pass
    for folder in folders:
        path = os.path.join(folder, LIBRARY)
        try:
            utilities = ctypes.CDLL(os.path.join(folder, "librcutils.so"), mode=ctypes.RTLD_GLOBAL)
            library: Any = ctypes.CDLL(path, mode=ctypes.RTLD_GLOBAL)
        except OSError:
            continue
        utilities.rcutils_get_default_allocator.restype = _Allocator
        library.rcl_yaml_node_struct_init.restype = ctypes.POINTER(_Parameters)
        library.rcl_yaml_node_struct_init.argtypes = [_Allocator]
        library.rcl_yaml_node_struct_fini.argtypes = [ctypes.POINTER(_Parameters)]
        library.rcl_parse_yaml_file.restype = ctypes.c_bool
        library.rcl_parse_yaml_file.argtypes = [ctypes.c_char_p, ctypes.POINTER(_Parameters)]
        library.rcl_parse_yaml_value.restype = ctypes.c_bool
        library.rcl_parse_yaml_value.argtypes = [*[ctypes.c_char_p] * 3, ctypes.POINTER(_Parameters)]
        library.allocator = utilities.rcutils_get_default_allocator()
        library.reset_error = utilities.rcutils_reset_error
        return library
    return None


class Unreadable(Exception):
    """The parser refuses an argument: a node with it does not start."""


def rcl_sections(files: Sequence[Path]) -> list[tuple[str, dict[str, Any]]] | None:
    """The sections that rcl has after it has read these files; None if it refuses one of them.

    A parameter without a value is None. Of a name that occurs twice in a section, the last counts, as for a node.
    """
    try:
        return _sections([("--params-file", os.fspath(path)) for path in files])
    except Unreadable:
        return None


def effective(rules: Sequence[tuple[str, str]], node: str) -> dict[str, Any]:
    """The parameters of the node with this full name, in the order of precedence of rclcpp.

    ``rules``: arguments of the process in their order, ``-p`` with a rule or ``--params-file`` with a path. Raises
    Unreadable.
    """
    found: dict[str, Any] = {}
    for section, values in _sections(rules):
        pattern = (section if section.startswith("/") else f"/{section}").replace("/*", r"(/\w+)")
        if re.fullmatch(pattern, node):
            found |= values
    return found


def _sections(rules: Sequence[tuple[str, str]]) -> list[tuple[str, dict[str, Any]]]:
    """Those that the library has after it has read the arguments, in their order. Raises Unreadable."""
    library = rcl_parser()
    assert library is not None
    into = library.rcl_yaml_node_struct_init(library.allocator)
    try:
        for option, rule in rules:
            if option == "--params-file":
                done = library.rcl_parse_yaml_file(os.fsencode(rule), into)
            else:
                name, _, value = rule.partition(":=")
                of, _, parameter = name.rpartition(":")
                if not re.fullmatch(r"[A-Za-z_][\w./~{}]*", parameter):
                    raise Unreadable(rule)
                section = "/**" if not of else of if of.startswith("/") else f"/{of}"
                done = library.rcl_parse_yaml_value(section.encode(), parameter.encode(), value.encode(), into)
            if not done:
                library.reset_error()
                raise Unreadable(rule)
        return list(_read(into.contents))
    finally:
        library.rcl_yaml_node_struct_fini(into)


def _read(found: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """The sections of what the library has read."""
    for index in range(found.count):
        of_node = found.parameters[index]
        values = ((of_node.names[place].decode(), _value(of_node.values[place])) for place in range(of_node.count))
        yield found.nodes[index].decode(), dict(values)


def _value(variant: _Variant) -> Any:
    for scalar in (variant.bool, variant.integer, variant.double):
        if scalar:
            return scalar[0]
    if variant.string is not None:
        return variant.string.decode()
    for array in (variant.bytes, variant.bools, variant.integers, variant.doubles):
        if array:
            return [array[0].values[index] for index in range(array[0].size)]
    if variant.strings:
        return [variant.strings[0].data[index].decode() for index in range(variant.strings[0].size)]
    return None
