"""The parameters that ROS's own parser gives a node for the arguments of its process, without a process or a node."""

from __future__ import annotations

import ctypes
import os
import re
import sys
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, Final

LIBRARY: Final = "librcl_yaml_param_parser.so"


class Unreadable(Exception):
    """The parser refuses an argument: a node with it does not start."""


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
def parser() -> tuple[Any, Any] | None:
    """The libraries of ROS, where they can be loaded."""
    for path in (LIBRARY, os.path.join(sys.prefix, "lib", LIBRARY)):
        try:
            library = ctypes.CDLL(path, mode=ctypes.RTLD_GLOBAL)
            utilities = ctypes.CDLL(path.replace(LIBRARY, "librcutils.so"), mode=ctypes.RTLD_GLOBAL)
        except OSError:
            continue
        utilities.rcutils_get_default_allocator.restype = _Allocator
        library.rcl_yaml_node_struct_init.restype = ctypes.POINTER(_Parameters)
        library.rcl_yaml_node_struct_init.argtypes = [_Allocator]
        library.rcl_yaml_node_struct_fini.argtypes = [ctypes.POINTER(_Parameters)]
        library.rcl_parse_yaml_file.restype = library.rcl_parse_yaml_value.restype = ctypes.c_bool
        library.rcl_parse_yaml_file.argtypes = [ctypes.c_char_p, ctypes.POINTER(_Parameters)]
        library.rcl_parse_yaml_value.argtypes = [*[ctypes.c_char_p] * 3, ctypes.POINTER(_Parameters)]
        return library, utilities
    return None


def effective(rules: Sequence[tuple[str, str]], node: str) -> dict[str, Any]:
    """The parameters of the node with this full name, in the order of precedence of rclcpp.

    ``rules``: arguments of the process in their order, ``-p`` with a rule or ``--params-file`` with a path. Raises
    Unreadable.
    """
    libraries = parser()
    assert libraries is not None
    library, utilities = libraries
    into = library.rcl_yaml_node_struct_init(utilities.rcutils_get_default_allocator())
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
                utilities.rcutils_reset_error()
                raise Unreadable(rule)
        return dict(_matching(into.contents, node))
    finally:
        library.rcl_yaml_node_struct_fini(into)


def _matching(found: _Parameters, node: str) -> Iterator[tuple[str, Any]]:
    for index in range(found.count):
        section = found.nodes[index].decode()
        pattern = (section if section.startswith("/") else f"/{section}").replace("/*", r"(/\w+)")
        if re.fullmatch(pattern, node):
            of_node = found.parameters[index]
            for place in range(of_node.count):
                yield of_node.names[place].decode(), _value(of_node.values[place])


def _value(variant: _Variant) -> Any:
    if variant.string is not None:
        return variant.string.decode()
    for scalar in (variant.bool, variant.integer, variant.double):
        if scalar:
            return scalar[0]
    for array in (variant.bytes, variant.bools, variant.integers, variant.doubles):
        if array:
            return [array[0].values[index] for index in range(array[0].size)]
    if variant.strings:
        return [variant.strings[0].data[index].decode() for index in range(variant.strings[0].size)]
    return None
