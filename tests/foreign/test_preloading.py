"""Whether the library of the gate is loaded into a program, as its file shows, beside what the loader does with it."""

from __future__ import annotations

import os
import shutil
import signal
import stat
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

import pytest

from midstride.foreign.elf import read_elf
from midstride.foreign.preloading import StartedPrograms, is_secure, why_not_loaded, why_unseen
from tests.native import c_compiler

# Says whether a library of the name that it is given is in its process, and waits if that is asked for.
PROGRAM = """
#include <stdio.h>
#include <string.h>
#include <unistd.h>
int main(int count, char **arguments)
{
  char line[4096];
  FILE *maps = fopen("/proc/self/maps", "r");
  int found = 0;
  while (maps && fgets(line, sizeof line, maps))
    found |= strstr(line, arguments[1]) != NULL;
  puts(found ? "loaded" : "not loaded");
  fflush(stdout);
  if (count > 2)
    pause();
  return 0;
}
"""
# Has a thread start the command that follows.
BY_A_THREAD = "import subprocess, sys, threading; threading.Thread(target=subprocess.run, args=(sys.argv[1:],)).start()"
NOBODY = 65534
CAP_SYS_NICE = 1 << 23
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="owners of files can be changed by root only")


@pytest.fixture(scope="module")
def compiled() -> Iterator[Callable[..., Path]]:
    """Compiles programs into a folder that other users can read, too."""
    with tempfile.TemporaryDirectory(dir="/tmp") as name:  # the folder for other tests may be closed to others
        os.chmod(name, 0o755)
        yield partial(compiled_in, Path(name))


def compiled_in(folder: Path, name: str, *options: str, source: str = PROGRAM) -> Path:
    command = c_compiler()
    (folder / f"{name}.c").write_text(source)
    arguments = [*command, "-o", str(folder / name), str(folder / f"{name}.c"), *options]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"it cannot be compiled with {options}: {done.stderr}")
    return folder / name


@pytest.fixture(scope="module")
def gate(compiled: Callable[..., Path], gate_library: Path) -> Path:
    """The library where another user can read it."""
    copied = compiled("unused").with_name(gate_library.name)
    shutil.copyfile(gate_library, copied)
    copied.chmod(0o755)
    return copied


def says(
    command: Sequence[str | Path], gate: Path, environment: Mapping[str, str] | None = None, user: int | None = None
) -> str:
    """What the program says of the library, started as Midstride starts it."""
    base = {"PATH": os.environ["PATH"], **(environment or {})}
    started = StartedPrograms.of([str(word) for word in command], 0, base)
    given = {**base, "LD_PRELOAD": started.preloaded(gate)}
    done = subprocess.run(
        [*command, gate.name], env=given, user=user, group=user, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def as_user(user: int, program: Path) -> str | None:
    """What is found of ``program`` by a process of another user."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        os.setgroups([])
        os.setgid(user)
        os.setuid(user)
        os.write(writer, (why_not_loaded(str(program)) or "").encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        found = pipe.read()
    os.waitpid(child, 0)
    return found or None


def test_a_plain_program_gets_the_library(compiled: Callable[..., Path], gate: Path) -> None:
    program = compiled("plain")
    assert why_not_loaded(str(program), read_elf(gate)) is None
    assert says([program], gate) == "loaded"


def test_a_statically_linked_program_does_not(compiled: Callable[..., Path], gate: Path) -> None:
    for name, options in (("static", ["-static"]), ("static_pie", ["-static-pie"])):
        program = compiled(name, *options)
        why = why_not_loaded(str(program), read_elf(gate))
        assert why == (
            f"{program} is statically linked, and no library can be loaded into it: declare it with `gate relay`"
        )
        assert says([program], gate) == "not loaded"


@needs_root
@pytest.mark.parametrize(("bit", "kind"), [(stat.S_ISUID, "user"), (stat.S_ISGID, "group")])
def test_a_program_with_such_a_bit_does_not(compiled: Callable[..., Path], gate: Path, bit: int, kind: str) -> None:
    program = compiled(f"set_{kind}")
    program.chmod(0o755 | bit)
    assert why_not_loaded(str(program)) is None and says([program], gate) == "loaded"  # of whoever starts it
    os.chown(program, NOBODY, NOBODY)
    program.chmod(0o755 | bit)
    why = why_not_loaded(str(program))
    assert why is not None and f"{program} is set-{kind}-ID, so the loader ignores `LD_PRELOAD`: declare it with" in why
    assert says([program], gate) == "not loaded"


@needs_root
def test_a_program_with_capabilities_does_not_unless_root_starts_it(compiled: Callable[..., Path], gate: Path) -> None:
    program = compiled("capable")
    try:
        os.setxattr(program, "security.capability", struct.pack("<5I", 0x02000001, CAP_SYS_NICE, 0, 0, 0))
    except OSError as error:
        pytest.skip(f"no capabilities can be given here: {error}")
    assert why_not_loaded(str(program)) is None and says([program], gate) == "loaded"
    why = as_user(NOBODY, program)
    assert why is not None and f"{program} has file capabilities, so the loader ignores `LD_PRELOAD`" in why
    assert "`gate relay` or `gate none`" in why and "setcap -r" in why
    assert says([program], gate, user=NOBODY) == "not loaded"


@needs_root
def test_with_ambient_capabilities_it_does(compiled: Callable[..., Path], gate: Path) -> None:
    if (setpriv := shutil.which("setpriv")) is None:
        pytest.skip("no setpriv here")
    program = compiled(
        "ambient",
        source=PROGRAM.replace("int main", _AMBIENT + "int main").replace(
            "  char line", '  printf("%d ", ambient());\n  char line', 1
        ),
    )
    options = [
        f"--reuid={NOBODY}",
        f"--regid={NOBODY}",
        "--clear-groups",
        "--inh-caps=+sys_nice",
        "--ambient-caps=+sys_nice",
    ]
    assert says([setpriv, *options, program], gate) == "1 loaded"


_AMBIENT = """
#include <sys/prctl.h>
static int ambient(void) { return prctl(PR_CAP_AMBIENT, PR_CAP_AMBIENT_IS_SET, 23, 0, 0); }
"""


def test_a_sanitizer_comes_before_the_library(compiled: Callable[..., Path], gate: Path) -> None:
    program = compiled("sanitized", "-fsanitize=address")
    aborted = subprocess.run([program, gate.name], env={"LD_PRELOAD": str(gate)}, capture_output=True, check=False)
    assert aborted.returncode and b"ASan runtime does not come first" in aborted.stderr, "so it was without"
    options = {"ASAN_OPTIONS": "detect_leaks=0"}
    assert says([program], gate, options) == "loaded"
    started = StartedPrograms((str(program),), {"LD_PRELOAD": "libasan.so.8 libm.so.6:libdl.so.2"})
    assert started.preloaded(gate) == f"libasan.so.8:{gate}:libm.so.6:libdl.so.2", "what is stated is kept"


def test_what_is_stated_stays_behind_the_library(gate: Path) -> None:
    assert StartedPrograms((), {}).preloaded(gate) == str(gate)
    assert StartedPrograms((), {"LD_PRELOAD": ""}).preloaded(gate) == str(gate)
    assert StartedPrograms((), {"LD_PRELOAD": "/lib/other.so"}).preloaded(gate) == f"{gate}:/lib/other.so"


def test_a_script_is_its_interpreter_and_env_what_it_starts(
    compiled: Callable[..., Path], gate: Path, tmp_path: Path
) -> None:
    static, plain = compiled("static", "-static"), compiled("plain")
    for name, first in (("direct", str(static)), ("by_env", f"/usr/bin/env {static.name}")):
        script = tmp_path / name
        script.write_text(f"#!{first}\n")
        script.chmod(0o755)
        path = {"PATH": f"{static.parent}:/usr/bin:/bin"}
        started = StartedPrograms.of([str(script), "--fast"], 0, path)
        assert started.programs[-1] == str(static)
        assert "statically linked" in (started.why_not(gate) or "")
    env = ["/usr/bin/env", "-i", "A=b", str(static), "C=d"]
    assert StartedPrograms.of(env, 0, {"PATH": "/bin"}).programs == ("/usr/bin/env", str(static))
    prefixed = StartedPrograms.of([str(static), "-n", str(plain)], 2, {"PATH": "/bin"})
    assert prefixed.programs == (str(static), str(plain))
    assert StartedPrograms.of([sys.executable, "node.py"], 0, {"PATH": "/bin"}).why_not(gate) is None
    assert StartedPrograms.of(["/no/such/program"], 0, {}).why_not(gate) is None, "that is said elsewhere"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["-u", "LD_PRELOAD"], "`env -u LD_PRELOAD` takes the library of the gate away"),
        (["-uLD_PRELOAD"], "`env -u LD_PRELOAD` takes"),
        (["-vu", "LD_PRELOAD", "A=b"], "`env -u LD_PRELOAD` takes"),
        (["--unset=LD_PRELOAD"], "`env -u LD_PRELOAD` takes"),
        (["-i", "A=b"], "`env -i` takes the library of the gate away (`LD_PRELOAD`)"),
        (["-"], "`env -` takes"),
        (["-C", "/", "--ignore-environment"], "`env --ignore-environment` takes"),
        (["LD_PRELOAD=libc.so.6"], "`env LD_PRELOAD=libc.so.6` puts another library in the place of the gate's"),
        (["-S", "-u LD_PRELOAD A=b"], "`env -u LD_PRELOAD` takes"),
        (["-u", "HOME", "-C", "/", "A=LD_PRELOAD"], None),
        (["--chdir=/", "--"], None),
        ([], None),
    ],
)
def test_env_may_take_the_library_away(
    compiled: Callable[..., Path], gate: Path, words: Sequence[str], said: str | None
) -> None:
    program = compiled("plain")
    command = ["/usr/bin/env", *words, str(program)]
    for length in (0, len(command) - 1):
        started = StartedPrograms.of(command, length, {"PATH": "/bin"})
        assert started.programs == ("/usr/bin/env", str(program)), "the program behind it is not found"
        why = started.why_not(gate)
        assert (why is None) if said is None else (why is not None and said in why and "`gate relay`" in why)
    assert says(command, gate) == ("loaded" if said is None else "not loaded")


def test_the_vector_of_a_process_of_32_bits_is_read_in_its_own_words() -> None:
    for bits, form in ((32, "=I"), (64, "=Q")):
        for secure in (0, 1):
            vector = b"".join(struct.pack(form, word) for word in (16, 7, 23, secure, 6, 4096, 0, 0, 0, 0, 0, 0))
            assert is_secure(vector, bits) == bool(secure)
            assert is_secure(vector + b"\0" * 4, bits) == bool(secure), "as if a part of a word was left"


def test_a_program_for_another_processor_does_not(compiled: Callable[..., Path], gate: Path) -> None:
    other = bytearray(compiled("plain").read_bytes())
    struct.pack_into("<H", other, 18, 40)
    program = gate.with_name("for_arm")
    program.write_bytes(other)
    assert f"{program} is for ARM (64 bits), and the library of the gate for " in (
        why_not_loaded(str(program), read_elf(gate)) or ""
    )


def test_what_publishes_by_agnocast_is_refused_by_what_it_is_linked_with(
    compiled: Callable[..., Path], gate: Path, tmp_path: Path
) -> None:
    library = tmp_path / "libagnocast.so"
    shutil.copyfile(compiled("empty", "-shared", "-fPIC", "-Wl,-soname,libagnocast.so", source="int nothing;"), library)
    program = compiled("agnocast", "-Wl,--no-as-needed", str(library))
    why = StartedPrograms((str(program),), {}).why_not(gate)
    assert why == (
        "what it publishes by Agnocast does not pass the gate "
        f"({program} is linked with libagnocast.so): declare it with `gate none`"
    )
    plain = str(compiled("plain"))
    component = StartedPrograms((plain,), {}, (str(program),)).why_not(gate)
    assert component == why, "a component's library"
    preloaded = StartedPrograms((plain,), {"LD_PRELOAD": "/opt/libagnocast_heaphook.so:libx.so"}).why_not(gate)
    assert "`LD_PRELOAD` has libagnocast_heaphook.so" in (preloaded or "")


def test_a_running_process_of_rcl_shows_that_the_library_was_taken_away(
    compiled: Callable[..., Path], gate: Path, tmp_path: Path
) -> None:
    library = tmp_path / "librcl.so"
    shutil.copyfile(compiled("empty_rcl", "-shared", "-fPIC", "-Wl,-soname,librcl.so", source="int nothing;"), library)
    program = compiled("of_rcl", "-Wl,--no-as-needed", str(library))
    shown = tmp_path / f"gate-0123456789abcdef-{os.uname().machine}.so"
    shutil.copyfile(gate, shown)
    without, having = "env -u LD_PRELOAD", "env A=b"
    for words, taken in (
        ((without,), True),
        ((having,), False),
        ((without, having), False),
        ((having, without), False),
    ):
        command = ["sh", "-c", " & ".join(f"{each} {program} x wait" for each in words) + "; wait"]
        environment = {**os.environ, "LD_PRELOAD": str(shown), "LD_LIBRARY_PATH": str(tmp_path)}
        process = subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True, env=environment)
        try:
            assert process.stdout is not None and all(process.stdout.readline() for _ in words)
            unseen = why_unseen(process.pid)
            assert (unseen is not None) == taken, words
            assert unseen is None or ("uses rcl, and was started without the library" in unseen.why)
            assert unseen is None or unseen.certain_after == 0.0
        finally:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()


@needs_root
def test_a_running_process_shows_why_it_is_not_seen(compiled: Callable[..., Path], gate: Path) -> None:
    program = compiled("running_set_user")
    os.chown(program, NOBODY, NOBODY)
    program.chmod(0o4755)
    for command, expected in (
        ([program], "got privileges at its start, so the loader has ignored `LD_PRELOAD`"),
        (["sh", "-c", f"{program} {gate.name} wait; true"], "got privileges at its start"),
        ([sys.executable, "-c", BY_A_THREAD, program], "got privileges at its start"),
        ([compiled("static", "-static")], "is statically linked"),
        ([compiled("plain")], None),
    ):
        process = subprocess.Popen([*command, gate.name, "wait"], stdout=subprocess.PIPE, start_new_session=True)
        try:
            assert process.stdout is not None and process.stdout.readline()
            unseen = why_unseen(process.pid)
            assert (unseen is None) if expected is None else unseen is not None and expected in unseen.why
        finally:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    assert why_unseen(process.pid) is None, "it has ended"
