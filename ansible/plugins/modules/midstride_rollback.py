#!/usr/bin/python
"""Ansible's module midstride_rollback."""

from __future__ import annotations

DOCUMENTATION = r"""
module: midstride_rollback
short_description: Change a running robot back to an earlier version of its specification
version_added: "0.1.0"
description:
  - Changes a running system to an earlier version of its specification, as C(midstride history) numbers them, while it
    runs.
  - Does nothing where that specification is in force.
  - Programs start with the code that is on the robot's disk. Where a version shall find its old programs again, those
    of another version have other paths.
options:
  version:
    description:
      - The version to go back to, such as the RV(midstride.fleet.midstride_status#module:version) from before the
        change.
    type: int
    required: true
extends_documentation_fragment:
  - midstride.fleet.robot
  - midstride.fleet.robot.change
author:
  - Midstride (@midstride)
"""

EXAMPLES = r"""
- name: Go back to what ran before
  midstride.fleet.midstride_rollback:
    version: "{{ before.version }}"
    setup: [/opt/ros/jazzy/setup.bash]
"""

RETURN = r"""
plan:
  description: The plan, as C(midstride plan --json) prints it, without the specifications before and after it.
  returned: when there is one
  type: dict
words:
  description: What was lost on the way, or in check mode what will be, in one sentence.
  returned: when there is a plan
  type: str
report:
  description: The report of the change, as C(midstride apply --json) prints it, with what each subscriber missed.
  returned: when the change was asked for
  type: dict
version_before:
  description: The version of the specification that was in force, as C(midstride history) numbers them.
  returned: when there is a plan
  type: int
version:
  description: The version that is in force now.
  returned: on success
  type: int
"""

from ansible.module_utils.basic import AnsibleModule  # noqa: E402
from ansible_collections.midstride.fleet.plugins.module_utils import robot  # noqa: E402


def main():
    module = AnsibleModule(argument_spec=robot.ROLLBACK, supports_check_mode=True)
    try:
        module.exit_json(**robot.rollback(module.params, module.check_mode, module._diff))
    except robot.Failure as failure:
        module.fail_json(msg=failure.message, **failure.result)


if __name__ == "__main__":
    main()
