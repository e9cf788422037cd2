"""Worker processes: child processes that run FMUs and may crash, hang or use up the memory.

process.py   parent's side: start a worker, exchange messages, enforce limits of time and memory, clean up;
             idle workers, kept for the next task
main.py      child's side: receive messages, run a function, end when the parent ends
wire.py      messages of the child as bytes that the parent can read without trust
calls.py     FMI calls in progress, and what a probe of `harvester check` is doing, readable after a crash

Runs, checks, studies and real-time machines load FMUs in worker processes. The child imports only the
standard library before its function needs more, so that it starts in less than 0.1 s. On Linux a run of the
command line has a fork of it instead.
"""
