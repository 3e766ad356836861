"""Programs that an import runs: each in its own session, so that nothing of it is left when it has ended."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

TIMEOUT: Final = 60.0  # s
MAX_OUTPUT: Final = 16_000_000  # bytes; the largest robot descriptions have a tenth


def run_command(words: Sequence[str], environment: Mapping[str, str], timeout: float = TIMEOUT) -> tuple[int, str, str]:
    """The exit status, the output and the errors of a program. Raises OSError, TimeoutError, ValueError."""
    with tempfile.TemporaryDirectory(prefix="midstride-") as folder:
        output, errors = Path(folder, "output"), Path(folder, "errors")
        # Files, not pipes: what the program has started may keep them open after its end.
        with open(output, "wb") as out, open(errors, "wb") as err:
            process = subprocess.Popen(
                list(words),
                env=dict(environment),
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                start_new_session=True,
            )
        try:
            status = process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise TimeoutError(f"it has not ended within {timeout:g} s") from None
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        if output.stat().st_size > MAX_OUTPUT:
            raise ValueError(f"it has written more than {MAX_OUTPUT} bytes")
        said, complained = (each.read_text(encoding="utf-8", errors="replace") for each in (output, errors))
        return status, said, complained
