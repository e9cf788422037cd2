"""Memory that two processes share and that nobody has to clean up: it has no name that outlives them.

On POSIX it is a file that is deleted already (on Linux one that never was on a disk), handed to the child as
an open descriptor; on Windows a named mapping, which goes with its last user.
"""

from __future__ import annotations

import mmap
import os
import secrets
import sys
import tempfile


class Memory:
    """A piece of shared memory, zero at first.

    address       what `attach` needs in the other process
    descriptors   that the other process has to inherit
    """

    def __init__(self, size: int) -> None:
        self.descriptors: tuple[int, ...] = ()
        if sys.platform == "win32":
            name = f"harvester-{secrets.token_hex(16)}"
            self.address = f"{name}:{size}"
            self.map = mmap.mmap(-1, size, tagname=name)
            return
        descriptor = _nameless()
        os.ftruncate(descriptor, size)
        self.descriptors = (descriptor,)
        self.address = f"{descriptor}:{size}"
        self.map = mmap.mmap(descriptor, size)

    def handed_over(self) -> None:
        """The other process has the descriptor; this one does not need it any more."""
        for descriptor in self.descriptors:
            os.close(descriptor)
        self.descriptors = ()


def attach(address: str) -> mmap.mmap:
    """The memory that another process has made."""
    where, _, size = address.partition(":")
    if sys.platform == "win32":
        return mmap.mmap(-1, int(size), tagname=where)
    descriptor = int(where)
    try:
        return mmap.mmap(descriptor, int(size))
    finally:
        os.close(descriptor)


def _nameless() -> int:
    """A file without a name."""
    if sys.platform == "linux":
        return os.memfd_create("harvester")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())
