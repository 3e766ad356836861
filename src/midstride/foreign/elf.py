"""The facts that the loader of Linux reads in a program or library: its kind of processor, and what it is linked
with.
"""

from __future__ import annotations

import mmap
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Final

_MAGIC: Final = b"\x7fELF"
_PT_LOAD, _PT_DYNAMIC, _PT_INTERP = 1, 2, 3
_DT_NEEDED, _DT_STRTAB = 1, 5
MACHINES: Final = {3: "x86", 40: "ARM", 62: "x86-64", 183: "arm64", 243: "RISC-V"}


@dataclass(frozen=True, slots=True)
class ElfFile:
    """A file in the format ELF. ``loader``: the path of what loads its libraries; empty where nothing does."""

    bits: int
    machine: int
    loader: str
    needed: tuple[str, ...]

    @property
    def processor(self) -> str:
        return f"{MACHINES.get(self.machine, f'ELF machine {self.machine}')} ({self.bits} bits)"

    def is_for_processor_of(self, other: ElfFile) -> bool:
        return (self.bits, self.machine) == (other.bits, other.machine)


def read_elf(path: str | Path) -> ElfFile | None:
    """Return what ``path`` is; None where it is no such file, or cannot be read."""
    try:
        with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            return _parsed(content)
    except (OSError, struct.error, IndexError, ValueError):
        return None


def _parsed(content: mmap.mmap) -> ElfFile | None:
    if content[:4] != _MAGIC:
        return None
    wide, order = content[4] == 2, "<" if content[5] == 1 else ">"
    (machine,) = struct.unpack_from(f"{order}H", content, 18)
    header = struct.Struct(f"{order}{'IIQQQQQQ' if wide else 'IIIIIIII'}")
    entry = struct.Struct(f"{order}{'qQ' if wide else 'iI'}")
    (table,) = struct.unpack_from(f"{order}{'Q' if wide else 'I'}", content, 32 if wide else 28)
    size, count = struct.unpack_from(f"{order}HH", content, 54 if wide else 42)
    loads: list[tuple[int, int, int]] = []  # address, offset, size
    dynamic, loader = b"", ""
    for index in range(count):
        fields = header.unpack_from(content, table + index * size)
        kind = fields[0]
        offset, address, length = (fields[2], fields[3], fields[5]) if wide else (fields[1], fields[2], fields[4])
        if kind == _PT_LOAD:
            loads.append((address, offset, length))
        elif kind == _PT_INTERP:
            loader = content[offset : offset + length].rstrip(b"\0").decode(errors="replace")
        elif kind == _PT_DYNAMIC:
            dynamic = content[offset : offset + length]
    entries = [entry.unpack_from(dynamic, at) for at in range(0, len(dynamic) - entry.size + 1, entry.size)]
    address = next((value for tag, value in entries if tag == _DT_STRTAB), None)
    found = (
        offset + address - start
        for start, offset, length in loads
        if address is not None and start <= address < start + length
    )
    strings = next(found, None)
    needed = (
        () if strings is None else tuple(_text(content, strings + value) for tag, value in entries if tag == _DT_NEEDED)
    )
    return ElfFile(64 if wide else 32, machine, loader, needed)


def _text(content: mmap.mmap, start: int) -> str:
    return content[start : content.find(b"\0", start)].decode(errors="replace")
