#!/usr/bin/python
"""Ansible's module midstride_apply."""

from __future__ import annotations

DOCUMENTATION = r"""
module: midstride_apply
short_description: Change a running robot to a specification
version_added: "0.1.0"
description:
  - Changes a running system to the specification in a file on the robot, and to the code that its programs have now,
    node by node and while it runs. A change that fails is rolled back by the robot's manager.
  - Does nothing where the system already is as the file says.
  - Fails where the change is refused, rolled back, or leaves something in a worse mode than planned.
options:
  file:
    description:
      - The specification, C(.stride) or C(.json), on the robot.
    type: path
    required: true
  keep_code:
    description:
      - Do not replace nodes only because their code has changed on disk.
    type: bool
    default: false
  same_process:
    description:
      - A replaced node of a container starts in the process that it is in, with the code that is loaded there, and ends
        with the others if it crashes.
    type: bool
    default: false
extends_documentation_fragment:
  - midstride.fleet.robot
  - midstride.fleet.robot.change
author:
  - Midstride (@midstride)
"""

EXAMPLES = r"""
- name: Show what the change would do, and what would degrade for how long
  midstride.fleet.midstride_apply:
    file: /opt/robot/8/robot.stride
    setup: [/opt/ros/jazzy/setup.bash]
  check_mode: true
  diff: true

- name: Change the robot
  midstride.fleet.midstride_apply:
    file: /opt/robot/8/robot.stride
    setup: [/opt/ros/jazzy/setup.bash]
  register: applied
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
    module = AnsibleModule(argument_spec=robot.APPLY, supports_check_mode=True)
    try:
        module.exit_json(**robot.apply(module.params, module.check_mode, module._diff))
    except robot.Failure as failure:
        module.fail_json(msg=failure.message, **failure.result)


if __name__ == "__main__":
    main()
