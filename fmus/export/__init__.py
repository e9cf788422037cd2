"""Any `Subsystem` as an .fmu file (FMI 2.0, native), any connected .fmu files as an .ssp."""

from fmus.export.build import build, build_all
from fmus.export.ssp import write_ssp

__all__ = ["build", "build_all", "write_ssp"]
