"""The cache of compiled code: only what nobody but the user can change is loaded."""

from __future__ import annotations

import logging
import os
import sys

import pytest

from orchestrator.base import compiler

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="owners and permissions of POSIX")
CODE, ARGUMENTS = {"one.c": b"int one(void) { return 1; }"}, ["-shared", "-fPIC", "one.c"]


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """The cache folder, not made yet; each test warns for itself."""
    monkeypatch.setattr(compiler, "cache_folder", lambda: tmp_path / "cache")
    compiler._warn_of_shared.cache_clear()
    return tmp_path / "cache"


def made():
    return compiler.shared_library("one.so", CODE, ARGUMENTS)


def test_the_cache_is_private(cache):
    """Folder and library are made so that nobody but the user can change them, whatever the umask."""
    before = os.umask(0)
    try:
        library = made()
    finally:
        os.umask(before)
    assert library.parent == cache
    assert (cache.stat().st_mode & 0o777, library.stat().st_mode & 0o777) == (0o700, 0o700)
    assert made() == library


def test_a_folder_that_others_can_write_to_is_not_used(cache, caplog):
    """The library is compiled for this process, and one line says why."""
    made().write_bytes(b"code of somebody else")
    cache.chmod(0o777)
    with caplog.at_level(logging.WARNING):
        library, again = made(), made()
    assert library.parent != cache
    assert again == library
    assert library.read_bytes() != b"code of somebody else"
    (message,) = [record.getMessage() for record in caplog.records]
    assert message.startswith(f"{cache}: expected a folder that only you own and can write to")


@pytest.mark.usefixtures("cache")
def test_a_folder_of_another_user_is_not_used(monkeypatch):
    """Also by the superuser, to whom every folder is open."""
    library, user = made(), os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: user + 1)
    assert made() != library


def test_a_file_that_others_can_write_to_is_made_again(cache):
    """A library with wrong permissions is replaced, not loaded."""
    library = made()
    library.write_bytes(b"code of somebody else")
    library.chmod(0o722)
    assert made() == library
    assert library.parent == cache
    assert library.read_bytes() != b"code of somebody else"
