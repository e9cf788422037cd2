"""What the worker processes of these tests do."""

import ctypes
import os
import pickle
import sys
import time


def echo(channel):
    """Every message back."""
    while True:
        channel.put("echo", channel.get())


def sleep(channel):  # noqa: ARG001
    """Never ends by itself."""
    time.sleep(1000)


def end(channel):
    """Ends as it is asked to, with some last words and a message before."""
    how = channel.get()
    print("nobody reads this", flush=True)
    print("first line\nlast line", file=sys.stderr, flush=True)
    channel.put("said", "before the end")
    channel.activity.call("fmi2DoStep")
    if how == "crash":
        ctypes.string_at(0)
    elif how == "abort":
        os.abort()
    elif how == "raise":
        raise ValueError("expected another one")
    elif isinstance(how, int):
        os._exit(how)


def graceful(channel):
    """Writes a file when it is not needed any more."""
    channel.grace = 10.0
    path = channel.get()
    channel.put("said", "ready")
    channel.ended.wait()
    with open(path, "w") as file:
        file.write("done")


def orphan(channel):
    """Ends and leaves a process behind that holds its output."""
    if os.fork() == 0:
        time.sleep(1000)
    channel.put("echo", os.getpid())


def parent(channel):
    """Starts a worker of its own and is killed before it can end it."""
    from typing import Any

    from orchestrator.worker.process import Worker

    child = Worker("jobs:echo", lambda: {"echo": Any}, "grandchild")
    child.put(1)
    child.get()
    channel.put("echo", [child.pid, str(child.folder)])
    channel.get()


def twin(channel):
    """A process that an FMU has forked sends, too."""
    pid = os.fork()
    channel.put("echo", [1, 2])
    if not pid:
        channel.put("echo", [3])
    os.waitpid(pid, 0)
    channel.put("echo", "end")


def spoilt(channel):
    """Does to its connection what the message says, and goes on."""
    how, path = channel.get()
    channel.put("said", "before")
    if how == "replaced":
        os.execv(sys.executable, [sys.executable, "-c", "import time; time.sleep(1000)"])
    elif how == "closed":
        os.closerange(0, 20)
    elif how == "code":
        os.write(channel._answers, pickle.dumps(Code(path)))
    elif how == "garbage":
        os.write(channel._answers, bytes(range(256)) * 20)
    elif how == "daemon" and not os.fork():
        os.setsid()
        if not os.fork():
            os.execve(sys.executable, [sys.executable, "-c", "import time; time.sleep(1000)"], {"MARK": path})
        os._exit(0)
    time.sleep(1000)


class Code:
    """Makes a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (self.path,)
