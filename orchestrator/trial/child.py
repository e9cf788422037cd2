"""Runs one probe in a process of its own: `python -m orchestrator.trial.child JOB_FOLDER`.

The folder holds job.json and the beacon; findings are appended to said.jsonl one by one, so that those
before a crash are kept.
"""

from __future__ import annotations

import json
import os
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from orchestrator.trial.beacon import Beacon
from orchestrator.trial.bench import Bench, Task
from orchestrator.trial.binary import Crashed, Missing, Refused
from orchestrator.trial.instance import Spent
from orchestrator.trial.reading import read


def main(folder: Path) -> None:
    """Do the job and leave at once: what an FMU does at the exit of the process is no longer of interest."""
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    with (folder / "said.jsonl").open("a", encoding="utf-8") as out:

        def write(**line: Any) -> None:
            out.write(json.dumps(line) + "\n")
            out.flush()

        bench = Bench(
            folder=Path(job["folder"]),
            declared=read(Path(job["folder"])),
            side=job["side"],
            beacon=Beacon(folder / "beacon"),
            seconds=job["seconds"],
            **job["habits"],
            payload=job["payload"],
            first=job["first"],
            at=lambda stage: write(stage=stage),
        )
        module, _, name = job["task"].partition(":")
        task: Task = getattr(import_module(f"orchestrator.trial.tasks.{module}"), name)
        try:
            for severity, text in task(bench):
                write(severity=severity, text=text)
        except Spent:
            pass  # the rest of the task needs another instance
        except (Refused, Missing) as problem:
            write(severity="error", text=str(problem))
        except Crashed as problem:
            write(crash=str(problem))
        except OSError as problem:
            write(severity="error", text=f"the binary cannot be loaded: {_first(problem)}")
        except Exception as problem:  # ours, not the FMU's: said as such, and the other probes go on
            write(severity="warning", text=f"could not be tried (a defect of this check): {problem!r}")
        write(done=True, result=bench.result)
    sys.stdout.flush()
    os._exit(0)


def _first(problem: OSError) -> str:
    """The message without the path of the temporary folder."""
    words = str(problem).split(": ", 1)
    return words[-1] if len(words) > 1 and "/" in words[0] else str(problem)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
