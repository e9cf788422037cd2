/* FMI 2.0 for co-simulation: passes each call to Python and returns its status, messages and value.

   Arguments and results are passed as bytes: arrays as they are in memory. The package fmus implements the calls
   (fmus/export/python/slave.py); start.h contains the Python code that loads the script of the FMU. */

#include "interpreter.c"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "start.h"

typedef struct {
    PyObject *dispatch; /* callable: (name of the function, arguments ...) -> (status, messages, value) */
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
    char name[];
} Instance;

typedef struct {
    const void *data;
    size_t size;
} Bytes;

/* Bytes in allocated memory, such as a saved state. */
typedef struct {
    size_t size;
    char bytes[];
} Blob;

/* ---- calls --------------------------------------------------------------------------------------- */

static Blob *blob(const char *data, size_t size) {
    Blob *result = malloc(sizeof *result + size);
    if (!result) return NULL;
    result->size = size;
    if (size) memcpy(result->bytes, data, size);
    return result;
}

/* A copy of one item of a tuple; null if the item is not bytes. */
static Blob *item(PyObject *tuple, int index) {
    PyObject *bytes = py.PyTuple_GetItem(tuple, index);
    const char *data = bytes ? py.PyBytes_AsString(bytes) : NULL;
    return data ? blob(data, (size_t)py.PyBytes_Size(bytes)) : NULL;
}

static PyObject *tuple_of(const Bytes arguments[], size_t n) {
    PyObject *tuple = py.PyTuple_New((ptrdiff_t)n);
    for (size_t i = 0; tuple && i < n; i++) {
        PyObject *bytes = py.PyBytes_FromStringAndSize(arguments[i].data, (ptrdiff_t)arguments[i].size);
        if (bytes && py.PyTuple_SetItem(tuple, (ptrdiff_t)i, bytes) == 0) continue;
        py.Py_DecRef(tuple);
        tuple = NULL;
    }
    return tuple;
}

static void log_error(const Instance *self, const char *text) {
    if (self->logger) self->logger(self->environment, self->name, fmi2Error, "logStatusError", text);
}

/* Logs messages. Each is a digit (the status), the category and the text, both with a terminating zero. */
static void log_messages(const Instance *self, const Blob *messages) {
    const char *position = messages->bytes, *end = position + messages->size;
    while (position < end && self->logger) {
        const char *category = position + 1, *text = category + strlen(category) + 1;
        self->logger(self->environment, self->name, (fmi2Status)(*position - '0'), category, text);
        position = text + strlen(text) + 1;
    }
}

/* One call, with Python locked. If not null, `value` gets a copy of the value, `object` the value itself. */
static fmi2Status call_locked(PyObject *function, const Bytes arguments[], size_t n, Blob **messages,
                              Blob **value, PyObject **object) {
    PyObject *tuple = tuple_of(arguments, n);
    PyObject *result = tuple ? py.PyObject_CallObject(function, tuple) : NULL;
    PyObject *status_object = result ? py.PyTuple_GetItem(result, 0) : NULL;
    const fmi2Status status = status_object ? (fmi2Status)py.PyLong_AsLong(status_object) : fmi2Error;
    if (result) *messages = item(result, 1);
    if (result && value) *value = item(result, 2);
    if (result && object && (*object = py.PyTuple_GetItem(result, 2))) py.Py_IncRef(*object);
    if (tuple) py.Py_DecRef(tuple);
    if (result) py.Py_DecRef(result);
    return status;
}

/* Unlocks Python; returns 1 if the user interrupted the call. */
static int unlock(int lock) {
    const int interrupted = py.PyErr_Occurred() && py.PyErr_ExceptionMatches(*py.PyExc_KeyboardInterrupt);
    py.PyErr_Clear();
    py.PyGILState_Release(lock);
    return interrupted;
}

/* Logs the messages of a call, or the fallback if there are none. Python is unlocked because the importer's logger
   may wait for a thread that needs Python. An interrupt is passed on to the program at the end, because its logger
   may be Python as well. */
static void finish(const Instance *self, Blob *messages, int interrupted, const char *fallback) {
    if (messages) log_messages(self, messages);
    else log_error(self, interrupted ? "interrupted by the user" : fallback);
    free(messages);
    if (interrupted) py.PyErr_SetInterrupt();
}

static fmi2Status call(const Instance *self, const Bytes arguments[], size_t n, Blob **value) {
    Blob *messages = NULL;
    for (size_t i = 0; i < n; i++)
        if ((!arguments[i].data && arguments[i].size) || arguments[i].size > PTRDIFF_MAX / 2) {
            log_error(self, "a null pointer or a wrong number of values");
            return fmi2Error;
        }
    const int lock = py.PyGILState_Ensure();
    const fmi2Status status = call_locked(self->dispatch, arguments, n, &messages, value, NULL);
    finish(self, messages, unlock(lock), "Python is out of memory");
    return status;
}

#define STRING(text) {text, strlen(text)}
#define ARRAY(array, n) {array, (n) * sizeof *(array)}
#define NUMBER(x) {&(x), sizeof(x)}
#define NAME STRING(__func__)
#define COUNT(a) (sizeof(a) / sizeof *(a))

/* A call whose value is copied to the importer's array. */
static fmi2Status call_into(const Instance *self, const Bytes arguments[], size_t n, void *array, size_t size) {
    Blob *value = NULL;
    fmi2Status status = call(self, arguments, n, &value);
    const int fits = array && value && value->size == size;
    if (status < fmi2Discard && fits && size) memcpy(array, value->bytes, size);
    if (status < fmi2Discard && !fits && size) {
        log_error(self, "there is no room for the values");
        status = fmi2Error;
    }
    free(value);
    return status;
}

/* ---- instances ----------------------------------------------------------------------------------- */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

/* The function `start` of start.h; Python is locked. */
static PyObject *start_function(void) {
    PyObject *module = py.PyImport_AddModule("_fmu_start");
    PyObject *names = module ? py.PyModule_GetDict(module) : NULL;
    PyObject *code = names ? py.Py_CompileString(START, "fmu_start.py", 257 /* a file */) : NULL;
    PyObject *result = code ? py.PyEval_EvalCode(code, names, names) : NULL;
    if (code) py.Py_DecRef(code);
    if (result) py.Py_DecRef(result);
    return result ? py.PyDict_GetItemString(names, "start") : NULL;
}

static void start_slave(Instance *self, const Bytes arguments[], size_t n) {
    Blob *messages = NULL;
    const int lock = py.PyGILState_Ensure();
    PyObject *start = start_function();
    fmi2Status status = fmi2Error;
    if (start) status = call_locked(start, arguments, n, &messages, NULL, &self->dispatch);
    if (status >= fmi2Error && self->dispatch) {
        py.Py_DecRef(self->dispatch); /* None */
        self->dispatch = NULL;
    }
    finish(self, messages, unlock(lock), "this Python cannot run the start of an FMU");
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn) {
    const char *name = instanceName ? instanceName : "", *guid = fmuGUID ? fmuGUID : "";
    const char *location = fmuResourceLocation ? fmuResourceLocation : "";
    Instance *self = calloc(1, sizeof *self + strlen(name) + 1);
    (void)visible;
    if (!self) return NULL;
    strcpy(self->name, name);
    self->logger = functions ? functions->logger : NULL;
    self->environment = functions ? functions->componentEnvironment : NULL;
    const char *problem = interpreter_start();
    if (fmuType != fmi2CoSimulation) problem = "the FMU is for co-simulation only";
    const Bytes arguments[] = {STRING(name), STRING(guid), STRING(location), STRING(loggingOn ? "1" : "0")};
    if (problem) log_error(self, problem);
    else start_slave(self, arguments, COUNT(arguments));
    if (self->dispatch) return self;
    free(self);
    return NULL;
}

void fmi2FreeInstance(fmi2Component c) {
    Instance *self = c;
    if (!self) return;
    const int lock = py.PyGILState_Ensure();
    py.Py_DecRef(self->dispatch);
    py.PyGILState_Release(lock);
    free(self);
}

/* A call without a value. */
#define CALL(c, ...)                                        \
    const Bytes arguments[] = {NAME, __VA_ARGS__};          \
    return c ? call(c, arguments, COUNT(arguments), NULL) : fmi2Error

#define CALL_WITHOUT_ARGUMENTS(function)                            \
    fmi2Status function(fmi2Component c) {                          \
        const Bytes arguments[] = {NAME};                           \
        return c ? call(c, arguments, 1, NULL) : fmi2Error;         \
    }

CALL_WITHOUT_ARGUMENTS(fmi2EnterInitializationMode)
CALL_WITHOUT_ARGUMENTS(fmi2ExitInitializationMode)
CALL_WITHOUT_ARGUMENTS(fmi2Terminate)
CALL_WITHOUT_ARGUMENTS(fmi2Reset)
CALL_WITHOUT_ARGUMENTS(fmi2CancelStep)

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[]) {
    char names[1024] = "";
    size_t used = 0;
    for (size_t i = 0; i < nCategories; i++) {
        const size_t length = strlen(categories[i]);
        if (used + length + 2 > sizeof names) return fmi2Error;
        memcpy(names + used, categories[i], length);
        used += length;
        names[used++] = '\n';
    }
    CALL(c, NUMBER(loggingOn), {names, used});
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real startTime, fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
    const double numbers[] = {(double)toleranceDefined, tolerance, startTime, (double)stopTimeDefined, stopTime};
    CALL(c, ARRAY(numbers, COUNT(numbers)));
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
    const double numbers[] = {currentCommunicationPoint, communicationStepSize};
    (void)noSetFMUStatePriorToCurrentPoint;
    CALL(c, ARRAY(numbers, COUNT(numbers)));
}

/* ---- values ---------------------------------------------------------------------------------------- */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[]) {
    const Bytes arguments[] = {NAME, ARRAY(vr, nvr)};
    return c ? call_into(c, arguments, COUNT(arguments), value, nvr * sizeof *value) : fmi2Error;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[]) {
    CALL(c, ARRAY(vr, nvr), ARRAY(value, nvr));
}

/* The model has Real variables only; Python refuses requests for variables of other types. */
#define NO_VARIABLES_OF(type)                                                                       \
    fmi2Status fmi2Get##type(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,            \
                             fmi2##type value[]) {                                                  \
        (void)value;                                                                                \
        CALL(c, ARRAY(vr, nvr));                                                                    \
    }                                                                                               \
    fmi2Status fmi2Set##type(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,            \
                             const fmi2##type value[]) {                                            \
        (void)value;                                                                                \
        CALL(c, ARRAY(vr, nvr));                                                                    \
    }

NO_VARIABLES_OF(Integer)
NO_VARIABLES_OF(Boolean)
NO_VARIABLES_OF(String)

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    CALL(c, ARRAY(vr, nvr), ARRAY(order, nvr), ARRAY(value, nvr));
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[]) {
    const Bytes arguments[] = {NAME, ARRAY(vr, nvr), ARRAY(order, nvr)};
    return c ? call_into(c, arguments, COUNT(arguments), value, nvr * sizeof *value) : fmi2Error;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[],
                                        size_t nUnknown, const fmi2ValueReference vKnown_ref[], size_t nKnown,
                                        const fmi2Real dvKnown[], fmi2Real dvUnknown[]) {
    const Bytes arguments[] = {NAME, ARRAY(vUnknown_ref, nUnknown), ARRAY(vKnown_ref, nKnown),
                               ARRAY(dvKnown, nKnown)};
    return c ? call_into(c, arguments, COUNT(arguments), dvUnknown, nUnknown * sizeof *dvUnknown) : fmi2Error;
}

/* ---- saved states ---------------------------------------------------------------------------------- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    const Bytes arguments[] = {NAME};
    Blob *value = NULL;
    if (!c || !FMUstate) return fmi2Error;
    const fmi2Status status = call(c, arguments, 1, &value);
    if (status < fmi2Error && value) {
        free(*FMUstate);
        *FMUstate = value;
        return status;
    }
    free(value);
    return fmi2Error;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate) {
    const Blob *state = FMUstate;
    CALL(c, {state ? state->bytes : "", state ? state->size : 0});
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    (void)c;
    if (FMUstate) {
        free(*FMUstate);
        *FMUstate = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
    if (!c || !FMUstate || !size) return fmi2Error;
    *size = ((const Blob *)FMUstate)->size;
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[],
                                 size_t size) {
    const Blob *state = FMUstate;
    if (!c || !state || !serializedState || size < state->size) return fmi2Error;
    memcpy(serializedState, state->bytes, state->size);
    return fmi2OK;
}

/* Python checks the bytes, so that those of another model are refused here and not when the state is set. */
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate) {
    const Bytes arguments[] = {NAME, {serializedState, size}};
    if (!c || !FMUstate) return fmi2Error;
    *FMUstate = NULL; /* undefined on entry */
    const fmi2Status status = call(c, arguments, COUNT(arguments), NULL);
    if (status < fmi2Error) *FMUstate = blob(serializedState, size);
    return status < fmi2Error && !*FMUstate ? fmi2Error : status;
}

/* ---- status ---------------------------------------------------------------------------------------- */

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    const Bytes arguments[] = {NAME, NUMBER(kind)};
    return c ? call_into(c, arguments, COUNT(arguments), value, sizeof *value) : fmi2Error;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    const Bytes arguments[] = {NAME, NUMBER(kind)};
    return c ? call_into(c, arguments, COUNT(arguments), value, sizeof *value) : fmi2Error;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    const Bytes arguments[] = {NAME, NUMBER(kind)};
    return c ? call_into(c, arguments, COUNT(arguments), value, sizeof *value) : fmi2Error;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    const Bytes arguments[] = {NAME, NUMBER(kind)};
    return c ? call_into(c, arguments, COUNT(arguments), value, sizeof *value) : fmi2Error;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    if (value) *value = "";
    CALL(c, NUMBER(kind));
}
