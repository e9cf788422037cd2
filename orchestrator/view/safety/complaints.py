"""What the libraries of the server say about a client that sends nonsense: one line, not a traceback."""

from __future__ import annotations

import logging

LIBRARIES = ("asyncio", "engineio.server", "socketio.server", "uvicorn.error")


def shorten() -> None:
    """From now on in one line each; may be repeated. What is ours has loggers of its own, with everything."""
    for name in LIBRARIES:
        logging.getLogger(name).addFilter(_one_line)


def _one_line(record: logging.LogRecord) -> bool:
    """Keeps the first line and the name of the error; the terminal cannot be filled by a page."""
    error = record.exc_info[1] if record.exc_info else None
    record.msg = record.getMessage().partition("\n")[0]
    if error is not None:
        record.msg += f": {type(error).__name__}"
    record.args, record.exc_info, record.exc_text = (), None, None
    return True
