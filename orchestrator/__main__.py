"""The command line `harvester`: what becomes of a command's text and end."""

from __future__ import annotations

import atexit
import os
import re
import sys
from contextlib import redirect_stdout, suppress
from io import StringIO, TextIOWrapper
from typing import Any, NoReturn, TextIO

from orchestrator.base.errors import Mistakes, Problem, Stopped, one_line
from orchestrator.base.extras import extra_of, install
from orchestrator.base.interrupts import signals_interrupt
from orchestrator.cli import application

INTERRUPTED = 130  # exit status: 128 and the number of SIGINT


class PrintableStream:
    """A text stream, such as standard output, without control characters other than breaks, tabs and colours.

    Names and descriptions in foreign files may contain them; a terminal would obey.
    """

    _ALLOWED = re.compile(r"(\n|\t|\x1b\[[0-9;]*m)")

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write a text with its control characters as escapes; returns its length as files do."""
        plain = text if text.isprintable() else "".join(map(self._escaped, self._ALLOWED.split(text)))
        self._stream.write(plain)
        return len(text)

    def _escaped(self, piece: str) -> str:
        return piece if self._ALLOWED.fullmatch(piece) else one_line(piece, len(piece))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; a mistake becomes one line on stderr and exit status 2."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a console that lacks the sign of a unit shows another one
    received = list[int]()
    try:
        with signals_interrupt(received), redirect_stdout(PrintableStream(sys.stdout or StringIO())):
            status = _with_notes(arguments)
    except KeyboardInterrupt as interrupt:
        return _stopped(received, str(interrupt))
    except Stopped as end:
        return _stopped(received, str(end))
    except Exception as error:
        return _stopped(received) if isinstance(error.__cause__, KeyboardInterrupt) else _told(error)
    if status == INTERRUPTED:  # some versions of the command-line library swallow the interrupt itself
        return _stopped(received)
    return status if isinstance(status, int) else 0


def _with_notes(arguments: list[str] | None) -> Any:
    """Run a command; the notes of an error, such as the card of a run that ended early, are printed."""
    try:
        app = application(*(sys.argv[1:] if arguments is None else arguments)[:1])
        return app(args=arguments, prog_name="harvester", standalone_mode=False)
    except Exception as error:
        for note in getattr(error, "__notes__", ()):
            print(note)
        raise


def _stopped(received: list[int], what: str = "") -> int:
    """Tell the end, and what is left of the work if the command says it; the exit status, as of a shell."""
    print(f"harvester: interrupted{what and '; '}{what}", file=sys.stderr)
    return 128 + received[0] if received else INTERRUPTED


def _told(error: Exception) -> int:
    """Tell a user's mistake or a refusal of the operating system in one line; re-raise defects."""
    show, message = getattr(error, "show", None), str(error)  # of the command-line library: show()
    if show is not None:
        message = error.format_message()  # type: ignore[attr-defined]
        if "\n" in message:  # no command given: its message is the help
            show()
            return 2
        context = getattr(error, "ctx", None)
        message = f"{message.rstrip('.')}; see {context.command_path if context else 'harvester'} --help"
    elif isinstance(error, ModuleNotFoundError) and (extra := extra_of(error.name or "")):
        message = f"the package {error.name} is not installed; install with: {install(extra)}"
    elif isinstance(error, OSError):
        message = f"{error.filename}: {error.strerror}" if error.filename else error.strerror or message
    elif not isinstance(error, Problem):
        raise error
    if isinstance(error, Mistakes):
        print("\n".join(f"harvester: {line}" for line in error.lines), file=sys.stderr)
        return 2
    print(f"harvester: {one_line(message)}", file=sys.stderr)
    return 2


def script() -> NoReturn:
    """Run the command line as a program.

    After an interrupt the process ends at once, after what is registered for its end: a thread of Arrow that
    waits for Python at that moment would abort it (github.com/apache/arrow, issue 34314).
    """
    status = main()
    if status == INTERRUPTED:
        atexit._run_exitfuncs()
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):  # nobody reads
                stream.flush()
        os._exit(status)
    sys.exit(status)


if __name__ == "__main__":
    script()
