"""Rules that load and run the FMU, each in a child process: a crash, a hang or an exit is a finding, too."""

from __future__ import annotations

from orchestrator.check.finding import Check, Rule
from orchestrator.check.probes.rules import loads, possible, probe, runs

STATE = ("canGetAndSetFMUstate", "canGetAndSetFMUState")
BYTES = ("canSerializeFMUstate", "canSerializeFMUState")
SLOPE = ("providesDirectionalDerivative", "providesDirectionalDerivatives")
ADJOINT = ("providesAdjointDerivatives",)
ORDER = ("maxOutputDerivativeOrder",)
UPDATE = ("providesIntermediateUpdate",)
EARLY = ("canReturnEarlyAfterIntermediateUpdate",)
CS, ME = ("cs",), ("me",)

# name, what must hold, check, threads where it was seen
TABLE: tuple[tuple[str, str, Check, str], ...] = (
    ("possible", "The FMU can be run on this machine, so that it can be tried", possible, ""),
    (
        "load",
        "The binary for this machine loads and has the functions of its sides",
        loads,
        "PythonFMU#110 FMPy#545 FMPy#642",
    ),
    (
        "default",
        "The default experiment runs to its end with finite values",
        runs,
        "FMIKit#225 OpenModelica#11229 rumoca#347",
    ),
    (
        "token",
        "A GUID or token of another build is refused",
        probe("loading:token"),
        "FMPy#167 FMIKit#80 OpenModelica#3809",
    ),
    (
        "first_output",
        "Values are right at once after initialisation",
        probe("values:first_output"),
        "FMIKit#219",
    ),
    (
        "drift",
        "Summed communication points are accepted",
        probe("time_and_state:drift", sides=CS),
        "FMIKit#133 FMPy#887 fmu_manipulation_toolbox#35",
    ),
    (
        "start_time",
        "A start time other than 0 works",
        probe("time_and_state:start_time"),
        "PyFMI#261 FMPy#638 OpenModelica#11855 Reference-FMUs#275",
    ),
    ("stop_time", "No stop time is needed", probe("time_and_state:stop_time"), ""),
    (
        "instances",
        "Instances in one process do not disturb each other",
        probe("loading:instances"),
        "casadi#3937 casadi#4212 FMIKit#328 FMIKit#397 into-cps#17",
    ),
    ("threads", "Instances may run in different threads", probe("loading:threads"), ""),
    (
        "leak",
        "Two thousand instances leave nothing behind",
        probe("leaks:leak", "leaks:reload"),
        "FMPy#110 FMPy#608 FMPy#343 OpenModelica#9220 PythonFMU#229",
    ),
    (
        "resources",
        "Folders and forms of the resource location do not matter",
        probe("loading:resources"),
        "FMPy#230 Reference-FMUs#74 chrono#772 rust-fmi#52",
    ),
    (
        "state",
        "A restored state goes on bit for bit",
        probe("time_and_state:restore", needs=STATE),
        "OpenModelica#7939 OpenModelica#12260 FMIKit#136 FMIKit#226 UniFMU#83",
    ),
    (
        "serialize",
        "A state goes on bit for bit in another process",
        probe("time_and_state:serialize", "time_and_state:elsewhere", needs=BYTES),
        "FMPy#811",
    ),
    ("reset", "A reset brings the first run again", probe("time_and_state:reset"), ""),
    (
        "directional",
        "Directional derivatives are derivatives",
        probe("derivatives:directional", needs=SLOPE),
        "FMPy#545",
    ),
    (
        "adjoint",
        "Adjoint derivatives equal directional derivatives",
        probe("derivatives:adjoint", needs=ADJOINT, major=3),
        "",
    ),
    (
        "output_derivatives",
        "Output derivatives are the slopes of the outputs",
        probe("derivatives:output_derivatives", sides=CS, needs=ORDER),
        "",
    ),
    (
        "dependencies",
        "What changes with an input lists it",
        probe("derivatives:dependencies"),
        "FMIKit#21 PyFMI#232",
    ),
    ("nominals", "Nominal values of states are positive", probe("solver:nominals", sides=ME), ""),
    (
        "late",
        "Parameters, states and time may be set between initialisation and continuous time",
        probe("solver:late", sides=ME, major=2),
        "OpenModelica#16354 OpenModelica#12893",
    ),
    ("stiff", "Explicit Euler can step the model", probe("solver:stiff", sides=ME), ""),
    ("values", "Senseless values are not answered with OK and NaN", probe("misuse:values"), "rumoca#347"),
    (
        "order",
        "Calls in a wrong state do not end the process",
        probe("misuse:order", crash="warning"),
        "",
    ),
    ("log", "Messages are in the declared categories", probe("loading:log"), ""),
    (
        "intermediate",
        "An intermediate update does not change the results",
        probe("update:intermediate", sides=CS, needs=UPDATE, major=3),
        "",
    ),
    (
        "early_return",
        "An early return is told",
        probe("update:early_return", sides=CS, needs=EARLY, major=3),
        "",
    ),
)
PROBES: tuple[Rule, ...] = tuple(
    Rule(f"run.{name}", text, check, tuple(threads.split())) for name, text, check, threads in TABLE
)
