"""What the library finds otherwise on Humble, on Lyrical, on Cyclone DDS: processes linked with libraries as there.

The names and forms are those of the sources (docs/reference/distributions.md); neither distribution has been run.
"""

from __future__ import annotations

import contextlib
import ctypes
import subprocess
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from midstride.foreign.gates import Gates
from midstride.foreign.page_layout import Within
from midstride.model.component import ComponentSpec
from tests.foreign.lab import MS, Lab, until, variables
from tests.foreign.test_response_watch import Server

REQUESTS = 20_000
TALKER = ComponentSpec.of("Talker", outputs=("out",), run="talker", gate="preload")


@pytest.fixture
def humble(tmp_path: Path, of_humble: Path, gate_library: Path) -> Iterator[Lab]:
    made = Lab(tmp_path, of_humble, gate_library)
    yield made
    made.close()


@pytest.fixture
def lyrical(tmp_path: Path, of_lyrical: Path, gate_library: Path) -> Iterator[Lab]:
    made = Lab(tmp_path, of_lyrical, gate_library)
    yield made
    made.close()


def test_servers_of_humble_share_requests_and_know_their_clients(humble: Lab) -> None:
    page = humble.page
    indices = [page.allocate(name) for name in ("old", "new")]
    page.have_requests(indices[0])
    page.have_requests(indices[1], indices[0])
    given = [variables(page.path, humble.programs, humble.library, humble.log, index) for index in indices]
    command = [str(humble.programs / "server"), "/count"]
    with subprocess.Popen(command, env=given[0], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL):
        until(lambda: "/count" in page.servers(indices[0]), "its server is not seen")
        until(lambda: page.servers(indices[0])["/count"].matched == 2, "its clients are not counted")
    both = [subprocess.Popen([*command, str(REQUESTS)], env=each, stdout=subprocess.DEVNULL) for each in given]
    assert [process.wait(60) for process in both] == [0, 0]
    assert sum(int(page.servers(index)["/count"].passed) for index in indices) == REQUESTS


def test_requests_are_shared_although_each_server_names_the_client_otherwise(
    tmp_path: Path, on_cyclone: Path, gate_library: Path
) -> None:
    lab = Lab(tmp_path, on_cyclone, gate_library)
    page = lab.page
    old, new = (page.allocate(name) for name in ("old", "new"))
    page.have_requests(old)
    page.have_requests(new, old)
    with contextlib.ExitStack() as processes:

        def started(index: int) -> Server:
            given = variables(page.path, lab.programs, lab.library, lab.log, index)
            command, pipe = [str(lab.programs / "server"), "/count"], subprocess.PIPE
            process = subprocess.Popen(command, env=given, stdin=pipe, stdout=pipe, text=True)
            processes.callback(process.communicate)
            processes.callback(process.kill)
            made = Server(process, lambda: page.servers(index)["/count"])
            made.done()
            return made

        first, second = started(old), started(new)
        for _ in range(3):
            second.does("take")  # held, as the old one answers
            first.does("take")
        for number in (1, 2, 3):
            first.does(f"answer {number}")
        page.give_requests(new, 0.0)
        second.does("take")  # the fourth: it has dropped those that the old one has answered
        second.does("answer 4")
        assert (int(first.port.passed), int(second.port.passed), int(second.port.answered)) == (3, 1, 1)
    lab.close()


def test_an_output_of_lyrical_is_kept_out_of_intra_process_communication(
    lyrical: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_WITHIN", "1")
    index = lyrical.page.allocate("talker")
    gates = Gates(lyrical.page, index, TALKER)
    gates.prepare({"out": "/chat"})
    lyrical.run(index, MS, 10**12)
    until(lambda: gates.entry("out").gated > 10, "its gate does not hold it back")
    assert lyrical.count() == 0, "a subscription of its process got a message past the closed gate"
    assert gates.entry("out").within & Within.KEPT_OUT
    gates.set_gate("out", True)
    until(lambda: lyrical.count() > 10, "it does not write")


class ServiceType(ctypes.Structure):
    """The begin of rosidl_service_type_support_t, as it is from Iron on."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("identifier", "data", "function", "request", "response")]


def handle_of(type_: Any) -> int:
    """The address of the type of a service of rclpy."""
    name, pointer = ctypes.pythonapi.PyCapsule_GetName, ctypes.pythonapi.PyCapsule_GetPointer
    name.restype, pointer.restype = ctypes.c_char_p, ctypes.c_void_p
    name.argtypes, pointer.argtypes = [ctypes.py_object], [ctypes.py_object, ctypes.c_char_p]
    return int(pointer(type_._TYPE_SUPPORT, name(type_._TYPE_SUPPORT)))


@pytest.mark.ros2
@pytest.mark.parametrize(
    ("package", "name"),
    [("rcl_interfaces", "ListParameters"), ("lifecycle_msgs", "ChangeState"), ("std_srvs", "SetBool")],
)
def test_by_name_the_types_of_messages_are_those_that_later_distributions_tell(
    gate_library: Path, package: str, name: str
) -> None:
    from rclpy.type_support import check_for_type_support

    type_ = getattr(import_module(f"{package}.srv"), name)
    check_for_type_support(type_)
    told = ServiceType.from_address(handle := handle_of(type_))
    request, response = ctypes.c_void_p(), ctypes.c_void_p()
    library = ctypes.CDLL(str(gate_library))
    library.midstride_named_types(ctypes.c_void_p(handle), ctypes.byref(request), ctypes.byref(response))
    assert told.request and (request.value, response.value) == (told.request, told.response)
