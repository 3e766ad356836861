"""Names of instances: of a further one, of whose role one may be, and of its node and its log file."""

from __future__ import annotations

import pytest

from midstride.model.instance_names import dotted_name, fresh_name, full_name, is_named_after, log_file_name, split_name


def test_a_further_instance_has_the_first_free_number() -> None:
    assert fresh_name("camera") == "camera_2"
    assert fresh_name("camera", {"camera", "camera_2"}, ["camera_3", "camera_5"]) == "camera_4"
    assert fresh_name("camera_2", {"camera_2"}) == "camera_2_2"


@pytest.mark.parametrize(
    ("instance", "role", "may_be"),
    [
        ("camera", "camera", True),
        ("camera_12", "camera", True),
        ("front/camera_2", "front/camera", True),
        ("camera_2_2", "camera_2", True),
        ("camera_2_2", "camera", False),
        ("camera_x", "camera", False),
        ("camera_", "camera", False),
        ("camera2", "camera", False),
        ("camera", "camera_2", False),
        ("front/camera", "camera", False),
    ],
)
def test_whose_instance_one_may_be(instance: str, role: str, may_be: bool) -> None:
    assert is_named_after(instance, role) is may_be


def test_a_fresh_name_is_one_of_its_role() -> None:
    assert is_named_after(fresh_name("front/camera", {"front/camera_2"}), "front/camera")


@pytest.mark.parametrize(
    ("name", "namespace", "full"),
    [
        ("camera", "", "/camera"),
        ("camera", "/", "/camera"),
        ("camera", "front", "/front/camera"),
        ("camera", "/front", "/front/camera"),
        ("front/camera", "front", "/front/camera"),
        ("front/camera", "", "/front/camera"),
        ("/a/b/camera_2", "ignored", "/a/b/camera_2"),
    ],
)
def test_the_name_of_its_node(name: str, namespace: str, full: str) -> None:
    assert full_name(name, namespace) == full
    base, inside = split_name(name, namespace)
    assert (inside.startswith("/"), "/" in base) == (True, False)
    assert full_name(base, inside) == full


@pytest.mark.parametrize(
    ("name", "dotted"), [("camera", "camera"), ("/camera_2", "camera_2"), ("/a/b/camera", "a.b.camera")]
)
def test_the_name_of_its_log_file(name: str, dotted: str) -> None:
    assert dotted_name(name) == dotted
    assert log_file_name(name) == f"{dotted}.log"
