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
#define DECLARE(name) name##TYPE name;
DECLARE(fmi2GetTypesPlatform) DECLARE(fmi2GetVersion) DECLARE(fmi2SetDebugLogging) DECLARE(fmi2Instantiate)
DECLARE(fmi2FreeInstance) DECLARE(fmi2SetupExperiment) DECLARE(fmi2EnterInitializationMode)
DECLARE(fmi2ExitInitializationMode) DECLARE(fmi2Terminate) DECLARE(fmi2Reset) DECLARE(fmi2GetReal)
DECLARE(fmi2GetInteger) DECLARE(fmi2GetBoolean) DECLARE(fmi2GetString) DECLARE(fmi2SetReal) DECLARE(fmi2SetInteger)
DECLARE(fmi2SetBoolean) DECLARE(fmi2SetString) DECLARE(fmi2GetFMUstate) DECLARE(fmi2SetFMUstate)
DECLARE(fmi2FreeFMUstate) DECLARE(fmi2SerializedFMUstateSize) DECLARE(fmi2SerializeFMUstate)
DECLARE(fmi2DeSerializeFMUstate) DECLARE(fmi2GetDirectionalDerivative) DECLARE(fmi2EnterEventMode)
DECLARE(fmi2NewDiscreteStates) DECLARE(fmi2EnterContinuousTimeMode) DECLARE(fmi2CompletedIntegratorStep)
DECLARE(fmi2SetTime) DECLARE(fmi2SetContinuousStates) DECLARE(fmi2GetDerivatives) DECLARE(fmi2GetEventIndicators)
DECLARE(fmi2GetContinuousStates) DECLARE(fmi2GetNominalsOfContinuousStates) DECLARE(fmi2SetRealInputDerivatives)
DECLARE(fmi2GetRealOutputDerivatives) DECLARE(fmi2DoStep) DECLARE(fmi2CancelStep) DECLARE(fmi2GetStatus)
DECLARE(fmi2GetRealStatus) DECLARE(fmi2GetIntegerStatus) DECLARE(fmi2GetBooleanStatus) DECLARE(fmi2GetStringStatus)
#endif

/* The body of a function that is allowed in the states `mask`. */
#define CALL(mask, body) return (fmi2Status)(allowed(c, __func__, mask) ? (body) : ERROR)

#endif
