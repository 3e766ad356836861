"""The paper's talker (section 5.2): says hello ten times a second."""

from std_msgs.msg import String

from midstride import Component

comp = Component("talker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])


def normal() -> None:
    out.write(String(data=f"hello world, this is {comp.instance}"))


def degraded() -> None:
    """Silent."""


talk.set_normal_mode(normal, rate=10, outputs=[out])
talk.set_degraded_mode(degraded)
comp.start()
