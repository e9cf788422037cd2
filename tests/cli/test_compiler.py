"""The cache of compiled code: only what nobody but the user can change is loaded."""

import ctypes
import logging
import os
from functools import partial

import pytest
from kit.needs import needs

from orchestrator.base import compiler

pytestmark = needs("POSIX", "owners and permissions of POSIX")
CODE, ARGUMENTS = {"one.c": b"int one(void) { return 1; }"}, ["-shared", "-fPIC", "-nostdlib", "one.c"]


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """The cache folder, not made yet; each test warns for itself."""
    monkeypatch.setattr(compiler, "cache_folder", lambda: tmp_path / "cache")
    compiler._warn_of_shared.cache_clear()
    return tmp_path / "cache"


def made(begin=None):
    return compiler.shared_library("one.so", CODE, ARGUMENTS, begin=begin)


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


@pytest.mark.usefixtures("cache")
def test_a_compilation_is_announced():
    """Not the library of the cache."""
    begun = []
    assert made(partial(begun.append, 1)) == made(partial(begun.append, 2))
    assert begun == [1]


def test_an_own_folder_that_others_can_write_to_becomes_private(cache, caplog):
    """Without a word, and its libraries are used: only a file that others can change is made again."""
    library = made()
    before = library.stat().st_mtime_ns
    cache.chmod(0o775)
    with caplog.at_level(logging.WARNING):
        assert made() == library
    assert cache.stat().st_mode & 0o777 == 0o700
    assert library.stat().st_mtime_ns == before
    assert not caplog.records


@pytest.mark.usefixtures("cache")
def test_a_link_in_the_cache_is_replaced(tmp_path):
    """It could have been made while others could write to the folder."""
    library, other = made(), tmp_path / "other.so"
    other.write_bytes(b"some other library")
    other.chmod(0o700)
    library.unlink()
    library.symlink_to(other)
    assert made() == library
    assert not library.is_symlink()
    assert other.read_bytes() == b"some other library"


def test_a_folder_of_another_user_is_not_used(cache, caplog, monkeypatch):
    """Also by the superuser, to whom every folder is open; one line says why."""
    library, user = made(), os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: user + 1)
    with caplog.at_level(logging.WARNING):
        own, again = made(), made()
    assert own != library
    assert cache not in (own.parent, again.parent)
    (message,) = [record.getMessage() for record in caplog.records]
    assert message.startswith(f"{cache}: expected a folder of your own")


@pytest.mark.parametrize("damage", [lambda _: b"", lambda code: code[:5], lambda code: code[:-1] + b"x"])
@pytest.mark.usefixtures("cache")
def test_a_damaged_file_is_made_again(damage):
    """After a power cut a library may be empty, cut or have other bytes, which would end the process."""
    library, kept = made(), partial(compiler.kept, "text", lambda: b"some text", [b"key"])
    assert kept() == b"some text"
    for file in library.parent.glob("*-*"):
        if file.suffix != ".sha256":
            file.write_bytes(damage(file.read_bytes()))
    assert ctypes.CDLL(str(made())).one() == 1
    assert kept() == b"some text"


def test_only_fmus_that_were_noted_are_generated(cache, tmp_path, monkeypatch):
    """By sources and description; in the cache of another user, or without one, nothing is."""
    code = {"sources/model.c": b"int x;", "modelDescription.xml": b"<x/>", "icon.png": b"1"}
    assert not compiler.is_generated(code)
    compiler.note_generated(code)
    assert compiler.is_generated(code | {"icon.png": b"2"})
    for name in ("sources/model.c", "modelDescription.xml", "sources/more.h"):
        assert not compiler.is_generated(code | {name: b"another"})
    next(cache.glob("*-generated")).chmod(0o622)  # anybody could have made it
    assert not compiler.is_generated(code)
    monkeypatch.setattr(compiler, "cache_folder", lambda: tmp_path / "none")
    assert not compiler.is_generated(code)


def test_a_file_that_others_can_write_to_is_made_again(cache):
    """A library with wrong permissions is replaced, not loaded."""
    library = made()
    library.write_bytes(b"code of somebody else")
    library.chmod(0o722)
    assert made() == library
    assert library.parent == cache
    assert library.read_bytes() != b"code of somebody else"
