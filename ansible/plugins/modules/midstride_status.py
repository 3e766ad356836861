#!/usr/bin/python
"""Ansible's module midstride_status."""

from __future__ import annotations

DOCUMENTATION = r"""
module: midstride_status
short_description: Say how a running robot is, or watch that all stays up
version_added: "0.1.0"
description:
  - Returns the condition of a running system, as its components report it.
  - With O(watch), fails at the first fault within that time, such as a node that exits, a functionality in a worse mode
    than the specification provides, or an output that writes less than half of the rate that it guarantees.
options:
  watch:
    description:
      - For how long all must be up, in seconds; V(0) for now. Without it, the module does not judge.
      - In check mode, which has changed nothing, it is not waited.
    type: float
  details:
    description:
      - Return RV(status) as well, which grows with the number of nodes.
    type: bool
    default: false
extends_documentation_fragment:
  - midstride.fleet.robot
attributes:
  check_mode:
    description: Nothing is changed in any mode.
    support: full
  diff_mode:
    description: There is no difference to show.
    support: none
author:
  - Midstride (@midstride)
"""

EXAMPLES = r"""
- name: All is up
  midstride.fleet.midstride_status:
    watch: 0
  register: before

- name: All stays up for a minute
  midstride.fleet.midstride_status:
    watch: 60
"""

RETURN = r"""
system:
  description: The name of the system.
  returned: when a manager answers
  type: str
condition:
  description: The C(state), V(up), V(degraded) or V(down), a C(headline), and the C(faults) in sentences.
  returned: when a manager answers
  type: dict
file:
  description: The file that was brought up, or applied last.
  returned: when a manager answers
  type: str
version:
  description: The version of the specification in force, as C(midstride history) numbers them.
  returned: when a manager answers
  type: int
status:
  description: The status, as C(midstride status --json) prints it.
  returned: with O(details)
  type: dict
"""

from ansible.module_utils.basic import AnsibleModule  # noqa: E402
from ansible_collections.midstride.fleet.plugins.module_utils import robot  # noqa: E402


def main():
    module = AnsibleModule(argument_spec=robot.STATUS, supports_check_mode=True)
    try:
        module.exit_json(**robot.status(module.params, module.check_mode))
    except robot.Failure as failure:
        module.fail_json(msg=failure.message, **failure.result)


if __name__ == "__main__":
    main()
