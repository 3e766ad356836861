"""Simulated processes without threads: their code is called on the simulator's loop, which is several times faster.

So it must not block: `time.sleep` would stop the whole simulation, and for real. What a program that hangs would do is
a fault (:mod:`midstride.simulation.faults`).
"""

from __future__ import annotations

import contextvars
from functools import partial
from typing import Any

from midstride.backends.simulator.cooperative_thread import CooperativeThread, Ended, ThreadYield
from midstride.backends.simulator.simulated_process import SimulatedProcess


class _Waits(BaseException):
    """The component has been started, and waits for work."""


class _OnLoop(CooperativeThread):
    """Calls each piece of work where a thread would be resumed with it."""

    process: SimulatedProcess
    _begun = False

    def resume(self, work: Any = None) -> ThreadYield:
        if self.ended:
            return Ended(None)
        try:
            if not self._begun:
                self._begun = True
                self._context.run(self._function)
            elif work is not None:
                self._context.run(work)
        except _Waits:
            return None
        except BaseException as error:
            self.ended = True
            return Ended(error)
        return self._unless_done()

    def _unless_done(self) -> ThreadYield:
        main = self.process.main
        if main is None or main.done():  # None: the program has ended without a component
            self.ended = True
            return Ended(None if main is None or main.cancelled() else main.exception())
        return None

    def kill(self) -> None:
        self.ended = True


class _OnLoopOnceStarted(_OnLoop):
    """Runs in a thread until the component has been started, and again, call by call, where ``blocks`` is set."""

    blocks = False
    _call: CooperativeThread | None = None

    def resume(self, work: Any = None) -> ThreadYield:
        if not self._begun:
            yielded = CooperativeThread.resume(self, work)
            if isinstance(yielded, Ended) and isinstance(yielded.error, _Waits):
                self._begun, self.ended = True, False
                return None
            return yielded
        if self._call is None:
            if not self.blocks or work is None:
                return super().resume(work)
            self._call = CooperativeThread(self.name, partial(work), self._context)
        yielded = self._call.resume()
        if not isinstance(yielded, Ended):
            return yielded
        self._call = None
        if yielded.error is not None:
            self.ended = True
            return yielded
        return self._unless_done()

    def kill(self) -> None:
        if self._call is not None:
            self._call.kill()
        if self._begun:
            self.ended = True
        else:
            CooperativeThread.kill(self)


class ThreadlessProcess(SimulatedProcess):
    """A simulated process without a thread, for programs that do not block."""

    def _new_thread(self, context: contextvars.Context) -> CooperativeThread:
        thread = _OnLoop(self.instance, self._program.run, context)
        thread.process = self
        return thread

    def run_work(self) -> None:
        raise _Waits


class ThreadlessOnceStarted(ThreadlessProcess):
    """For programs that sleep only until they call ``start()``, and after :meth:`let_block`."""

    _thread: _OnLoopOnceStarted

    def _new_thread(self, context: contextvars.Context) -> CooperativeThread:
        thread = _OnLoopOnceStarted(self.instance, self._program.run, context)
        thread.process = self
        return thread

    def let_block(self) -> None:
        """From now on its calls may sleep, too."""
        self._thread.blocks = True
