"""`harvester rig`, `describe` and `identify`: make and describe recordings, and estimate parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.base.files import make_folder
from orchestrator.base.options import Kind
from orchestrator.cli.options import BUILD, File, Folder, Text, command


@command
def rig(out: Folder, machine: Text = "detailed", seed: Annotated[int, Kind("N")] = 0) -> None:
    """Record the paper's experiments on a virtual test rig.

    Writes CSV files like those of a real test rig, from simulations.

    out       Folder for the recordings; it may contain earlier recordings, but no other files.
    machine   Variants of the simulated machine: lumped (as in the paper) or detailed.
    seed      Seed of the noise, 0 or more; equal seeds give equal files.
    """
    require("model", "harvester rig")
    import os

    from fmus.rig import write_all

    write_all(out, machine, seed, processes=os.cpu_count() or 1)


@command
def describe(
    data: Annotated[Path, Kind("FILE", positional=True)],
    out: File | None = None,
    procedure: Annotated[str | None, Kind("NAME")] = None,
    force: bool = False,
) -> None:
    """Describe the columns of a data file in a first .toml file, and print what was found in them.

    The file has the names and units of the columns, and in comments the signals that each may be. With the
    right names filled in, `harvester identify` and `validate` read it.

    data        What a logger wrote (.csv, .parquet, .mat, .mf4, .tdms).
    out         File to write (.toml), in the folder of the data; default: with the name of the data.
    procedure   Experiment for `harvester identify`, such as rest, valve or machine; default: none.
    force       Overwrite an existing file.
    """
    from fmus.identification.recordings.describe import describe as described

    print(described(data, out, procedure or "", force))


@command
def identify(
    folder: Annotated[Path, Kind("DIR", positional=True)],
    out: File = Path("parameters.toml"),
    report: Folder = BUILD,
    joint: bool = True,
    free: Annotated[list[str] | None, Kind("NAME")] = None,
    crane: File | None = None,
) -> int:
    """Estimate the machine's parameters from recordings.

    First with each procedure of the paper, then all parameters together. Exit status 0: estimates without a
    warning; 1: estimates and a report are written, but a warning says why the estimates are doubtful, such
    as residuals far above the noise of the sensors; 2: a mistake, nothing is written; 3: estimates and a
    report are written, but a test shows that the data contradict an assumption, and a warning names it, such
    as the zero of a sensor. Where there is reason for 1 and 3, it is 1.

    folder    Folder of recordings: data files, each with a .toml that describes the columns. With --crane: a
              log, or a folder of logs.
    out       File for the estimated parameters (.toml).
    report    Folder of identification.html and identification.json.
    joint     Refine all parameters together, if there is a recording of the whole machine.
    free      Parameter that `joint` may change, by its name in parameters.toml; default: those that a work
              cycle excites.
    crane     Identify the crane that this file (.toml) describes, see `harvester crane`: valves, leakage and
              masses, from logs whose columns have the names of its functions, such as boom_command.
    """
    require("identify", "harvester identify")
    if crane is not None:
        if free or not joint:
            raise Problem(f"--crane {crane}: expected no --free and no --no-joint: cranes have no refinement")
        from fmus.crane.check import checked
        from fmus.identification.crane import run as run_crane

        found = run_crane(checked(crane)[0], folder, out)
        print(found.text())
        print("Report: {}, {}".format(*found.write(report / "identification.html")))
        return 0 if found.passed else 1 if found.data["doubtful"] else 3
    if not folder.is_dir():  # before the slow imports
        got = "a file" if folder.is_file() else "no such file or folder"
        raise Problem(f"{folder}: expected a folder of recordings, got {got}")
    from fmus.identification.machine import FREE
    from fmus.identification.pipeline import run as run_identify

    make_folder(out.parent)
    make_folder(report)
    names = tuple(free or FREE)
    return run_identify(folder, out, report, joint=joint, names=names)
