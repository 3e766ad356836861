"""Another talker, to take the first one's place while it talks: it says something else."""

from std_msgs.msg import String

from midstride import Component

comp = Component("new_talker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
said = 0


def normal() -> None:
    global said
    said += 1
    out.write(String(data=f"good news from {comp.instance}, number {said}"))


def degraded() -> None:
    """Silent."""


talk.set_normal_mode(normal, rate=10, outputs=[out])
talk.set_degraded_mode(degraded)
comp.start()
