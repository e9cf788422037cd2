/* FMI 2.0: the macro that the fmi2*.c files share. */

#ifndef FMI2_H
#define FMI2_H

#include "fmi2Functions.h"
#include "instance.h"

/* Some copies of the standard's header, such as FMPy's, ignore the prefix: there the functions are named and
   declared here. The standard's own header is known by its macro fmi2Paste. */
#if defined FMI2_FUNCTION_PREFIX && !defined fmi2Paste
#undef fmi2FullName
#define fmi2Paste(a, b) a##b
#define fmi2PasteB(a, b) fmi2Paste(a, b)
#define fmi2FullName(name) fmi2PasteB(FMI2_FUNCTION_PREFIX, name)
#define DECLARE(name) fmi2##name##TYPE fmi2##name;
DECLARE(GetTypesPlatform) DECLARE(GetVersion) DECLARE(SetDebugLogging) DECLARE(Instantiate) DECLARE(FreeInstance)
DECLARE(SetupExperiment) DECLARE(EnterInitializationMode) DECLARE(ExitInitializationMode) DECLARE(Terminate)
DECLARE(Reset) DECLARE(GetReal) DECLARE(GetInteger) DECLARE(GetBoolean) DECLARE(GetString) DECLARE(SetReal)
DECLARE(SetInteger) DECLARE(SetBoolean) DECLARE(SetString) DECLARE(GetFMUstate) DECLARE(SetFMUstate)
DECLARE(FreeFMUstate) DECLARE(SerializedFMUstateSize) DECLARE(SerializeFMUstate) DECLARE(DeSerializeFMUstate)
DECLARE(GetDirectionalDerivative) DECLARE(EnterEventMode) DECLARE(NewDiscreteStates) DECLARE(EnterContinuousTimeMode)
DECLARE(CompletedIntegratorStep) DECLARE(SetTime) DECLARE(SetContinuousStates) DECLARE(GetDerivatives)
DECLARE(GetEventIndicators) DECLARE(GetContinuousStates) DECLARE(GetNominalsOfContinuousStates)
DECLARE(SetRealInputDerivatives) DECLARE(GetRealOutputDerivatives) DECLARE(DoStep) DECLARE(CancelStep)
DECLARE(GetStatus) DECLARE(GetRealStatus) DECLARE(GetIntegerStatus) DECLARE(GetBooleanStatus) DECLARE(GetStringStatus)
#endif

/* The body of a function that is allowed in the states `mask`. */
#define CALL(mask, body) return (fmi2Status)(allowed(c, __func__, mask) ? (body) : ERROR)

#endif
