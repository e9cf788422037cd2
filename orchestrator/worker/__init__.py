"""A child process that works for this one, and may die of its work.

process.py   the parent's side: start, messages, limits of time and memory, how it ended, removal of files
main.py      the child's side: reads messages, runs a function, ends when the parent does
beacon.py    what the child is doing right now, in shared memory that outlives a crash

FMUs are code of others: they crash, hang, exit and fill the memory. Whoever loads one for a check, a study or
a machine in real time does it in such a process. The child imports nothing but the standard library before
its function asks for more, so that it starts in less than 0.1 s.
"""
