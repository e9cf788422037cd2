"""The functions that a shared library must export, by version and kind; all of them, whatever it can do.

FMI 2.0.5, section 2.3: those of Model Exchange, of Co-Simulation or of both, also where a capability flag is
false. FMI 3.0.1, section 2.5: those of fmi3Functions.h, for whichever interface types.
"""

from __future__ import annotations

from collections.abc import Iterable

COMMON_2 = """GetTypesPlatform GetVersion SetDebugLogging Instantiate FreeInstance SetupExperiment
    EnterInitializationMode ExitInitializationMode Terminate Reset GetReal GetInteger GetBoolean GetString
    SetReal SetInteger SetBoolean SetString GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize
    SerializeFMUstate DeSerializeFMUstate GetDirectionalDerivative"""
EXCHANGE_2 = """EnterEventMode NewDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep SetTime
    SetContinuousStates GetDerivatives GetEventIndicators GetContinuousStates GetNominalsOfContinuousStates"""
SIMULATION_2 = """SetRealInputDerivatives GetRealOutputDerivatives DoStep CancelStep GetStatus GetRealStatus
    GetIntegerStatus GetBooleanStatus GetStringStatus"""
TYPES_3 = "Float32 Float64 Int8 UInt8 Int16 UInt16 Int32 UInt32 Int64 UInt64 Boolean String Binary Clock"
ALL_3 = """GetVersion SetDebugLogging InstantiateModelExchange InstantiateCoSimulation
    InstantiateScheduledExecution FreeInstance EnterInitializationMode ExitInitializationMode
    EnterEventMode Terminate Reset GetNumberOfVariableDependencies GetVariableDependencies
    GetFMUState SetFMUState FreeFMUState SerializedFMUStateSize SerializeFMUState
    DeserializeFMUState GetDirectionalDerivative GetAdjointDerivative EnterConfigurationMode
    ExitConfigurationMode GetIntervalDecimal GetIntervalFraction GetShiftDecimal GetShiftFraction
    SetIntervalDecimal SetIntervalFraction SetShiftDecimal SetShiftFraction EvaluateDiscreteStates
    UpdateDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep SetTime SetContinuousStates
    GetContinuousStateDerivatives GetEventIndicators GetContinuousStates
    GetNominalsOfContinuousStates GetNumberOfEventIndicators GetNumberOfContinuousStates
    EnterStepMode GetOutputDerivatives DoStep ActivateModelPartition"""


def required(major: int, kinds: Iterable[str]) -> tuple[str, ...]:
    """Names of all functions that an FMU of these kinds must export."""
    if major == 3:
        access = (f"{verb}{type_}" for verb in ("Get", "Set") for type_ in TYPES_3.split())
        return tuple(f"fmi3{name}" for name in (*ALL_3.split(), *access))
    offered = set(kinds)
    names = COMMON_2.split()
    names += EXCHANGE_2.split() if "ModelExchange" in offered else []
    names += SIMULATION_2.split() if "CoSimulation" in offered else []
    return tuple(f"fmi2{name}" for name in names)
