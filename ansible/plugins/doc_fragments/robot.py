"""The options that all modules of the collection share, and those of a change."""

from __future__ import annotations


class ModuleDocFragment:
    DOCUMENTATION = r"""
options:
  system:
    description:
      - The running system; needed only if several are running on the robot.
    type: str
  executable:
    description:
      - The C(midstride) command on the robot, as a name on its PATH or as a path.
    type: str
    default: midstride
  setup:
    description:
      - Scripts on the robot that Bash reads before the command, in order, such as V(/opt/ros/jazzy/setup.bash).
      - A login by Ansible reads no C(.bashrc).
    type: list
    elements: path
    default: []
  timeout:
    description:
      - How long each call of the command may take, in seconds, besides the time that it is to watch.
      - The module then fails, and says what becomes of the change; the manager may go on with it.
    type: float
    default: 600
requirements:
  - Midstride on the robot, for the user that the task runs as, whose manager runs.
notes:
  - The manager is found in the E(XDG_RUNTIME_DIR) of the task's user. Where that is not set, as after C(become), set it
    with the keyword C(environment).
"""

    CHANGE = r"""
options:
  strategy:
    description:
      - The algorithm that makes the plan. V(minimal) loses the least; V(paper) follows the paper's algorithm;
        V(quiesce) first degrades all that is affected; V(stop) stops everything, and starts it again.
    type: str
    choices: [minimal, paper, quiesce, stop]
    default: minimal
  detours:
    description:
      - With strategy V(minimal), also try to move nodes that stay, and stand-ins that exist during the change only.
    type: bool
    default: false
  declared_parameters:
    description:
      - Start with the declared values of parameters instead of those that were set at run time.
    type: bool
    default: false
  with_other_nodes:
    description:
      - Also where other nodes end with a process that the change ends, as the components in a container do. Without
        this option, such a change is refused with their names.
    type: bool
    default: false
  wait:
    description:
      - How long to wait for a hung node that is being replaced before its outputs are blocked, in seconds.
    type: float
    default: 5
  despite_lock:
    description:
      - Change the system although it is locked; the history says so.
    type: bool
    default: false
  despite_requirements:
    description:
      - Change the system although what its changes require does not hold; the history says so.
    type: bool
    default: false
  verify:
    description:
      - Verify the plan with Alloy before it starts, and the running system after each step.
    type: bool
    default: false
attributes:
  check_mode:
    description: The plan is made, by the manager and from the present state, and nothing is changed.
    support: full
  diff_mode:
    description: The plan in words, as C(midstride plan) prints it, with what degrades, for how long and why.
    support: full
"""
