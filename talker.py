from std_msgs.msg import String

from midstride import Component

comp = Component("talker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])


def check(value):
    if value < -10:
        raise ValueError("it must be at least -10")


gain = comp.parameter("gain", 1.5, on_change=check)
names = comp.parameter("names", ["a"], on_change=lambda value: None)
talk.set_normal_mode(lambda: out.write(String(data=str(gain.value))), rate=10, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
