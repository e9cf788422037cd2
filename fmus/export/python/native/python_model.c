/* The model in Python, in place of the equations and the solver of other FMUs (../../native/equations.c).

   Values are passed as arrays of doubles in bytes. All instances share one object of Python, whose methods keep
   nothing between calls (fmus/export/python/slave.py); loader.h contains the code that loads it. */

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "instance.h"
#include "interpreter.h"
#include "loader.h"

static PyObject *model; /* has the method `call`; lives as long as the process, because Python does */
static int interrupted; /* 1 until an interrupt by the user is passed on to the program */

/* 1 if a call of Python succeeded; else the reason in PROBLEM bytes of `text`. Python is locked. */
static int succeeded(PyObject *result, char *text) {
    const char *problem = result ? py.PyUnicode_AsUTF8AndSize(result, NULL) : "Python is out of memory";
    if (!result && py.PyErr_Occurred() && py.PyErr_ExceptionMatches(*py.PyExc_KeyboardInterrupt)) {
        problem = "interrupted by the user";
        interrupted = 1;
    }
    py.PyErr_Clear();
    if (problem) snprintf(text, PROBLEM, "%s", problem);
    return !problem;
}

/* The program gets an interrupt only now, because the importer's logger may be Python, too. */
void core_reported(void) {
    if (!interrupted) return;
    interrupted = 0;
    py.PyErr_SetInterrupt();
}

/* The function `load` of loader.h; Python is locked. */
static PyObject *loader(void) {
    PyObject *module = py.PyImport_AddModule("_fmu_loader");
    PyObject *names = module ? py.PyModule_GetDict(module) : NULL;
    PyObject *code = names ? py.Py_CompileString(LOADER, "fmu_loader.py", 257 /* a file */) : NULL;
    PyObject *result = code ? py.PyEval_EvalCode(code, names, names) : NULL;
    if (code) py.Py_DecRef(code);
    if (result) py.Py_DecRef(result);
    return result ? py.PyDict_GetItemString(names, "load") : NULL;
}

const char *core_load(int type, const char *resources, char *text) {
    if (type != CO_SIMULATION) return "the FMU is for co-simulation only";
    const char *problem = interpreter_start();
    if (problem) return problem;
    const int lock = py.PyGILState_Ensure();
    if (!model) {
        PyObject *load = loader();
        PyObject *loaded = load ? py.PyObject_CallFunction(load, "ss", resources ? resources : "", model_guid) : NULL;
        if (!succeeded(loaded, text)) problem = text;
        else if (!model) model = loaded; /* another thread may have loaded it meanwhile */
        if (loaded && loaded != model) py.Py_DecRef(loaded);
    }
    py.PyGILState_Release(lock);
    return problem;
}

/* Calls a method with n doubles and gets m; 0 and the reason in core->problem if that fails. */
static int call(Core *core, const char *method, const double *arguments, size_t n, double *results, size_t m) {
    const int lock = py.PyGILState_Ensure();
    PyObject *bytes = py.PyBytes_FromStringAndSize((const char *)arguments, (ptrdiff_t)(n * sizeof *arguments));
    PyObject *result = bytes ? py.PyObject_CallMethod(model, "call", "sN", method, bytes) : NULL;
    *core->problem = '\0';
    int done = succeeded(result, core->problem);
    if (done && (size_t)py.PyBytes_Size(result) != m * sizeof *results) {
        snprintf(core->problem, PROBLEM, "the model has other variables than at its build");
        done = 0;
    }
    if (done) memcpy(results, py.PyBytes_AsString(result), m * sizeof *results);
    if (result) py.Py_DecRef(result);
    py.PyGILState_Release(lock);
    return done;
}

/* Appends n doubles to the arguments of a call; returns their end. */
static double *append(double *end, const double *values, size_t n) {
    memcpy(end, values, n * sizeof *values);
    return end + n;
}

/* States, inputs and parameters. */
static double *append_values(double *end, const State *s) {
    return append(append(append(end, s->x, NX), s->u, NU), s->p, NP);
}

void core_start(Core *core) {
    double arguments[ROOM(NX + NU + NP)], start[ROOM(NX)];
    if (!core->s.initial || core->start_valid) return;
    append_values(arguments, &core->s);
    if (!call(core, "start", arguments, NX + NU + NP, start, NX)) return;
    memcpy(core->s.x, start, NX * sizeof *start);
    core->start_valid = 1;
    core_invalidate_states(core);
}

void core_outputs(Core *core) {
    double arguments[NX + NU + NP + 1], results[ROOM(NY + NREQUIRE)];
    core_start(core);
    if (core->y_valid || *core->problem) return;
    append(append_values(arguments, &core->s), &core->s.time, 1);
    if (!call(core, "observe", arguments, NX + NU + NP + 1, results, NY + NREQUIRE)) return;
    memcpy(core->y, results, NY * sizeof *results);
    memcpy(core->require, results + NY, NREQUIRE * sizeof *results);
    core->y_valid = 1;
}

void core_require(Core *core) { core_outputs(core); }

int core_advance(Core *core, double length) {
    State *s = &core->s;
    const InputPolynomials *inputs = &core->inputs;
    double arguments[NX + 4 * NU + NP + 2], x[ROOM(NX)], u[ROOM(4 * NU)] = {0};
    const double times[] = {s->time, length};
    memcpy(u, inputs->start, NU * sizeof *u);
    for (int k = 0; k < inputs->count; k++)
        for (int order = 1; order < 4; order++) {
            const int i = inputs->moving[k];
            u[order * NU + i] = inputs->coefficients[i][order - 1];
        }
    append(append(append(append(arguments, s->x, NX), u, 4 * NU), s->p, NP), times, 2);
    if (!call(core, "advance", arguments, NX + 4 * NU + NP + 2, x, NX)) return !core_failed(core);
    memcpy(s->x, x, NX * sizeof *x);
    core_set_time(core, s->time, length);
    return 1;
}

/* ---- what only a model in equations has ------------------------------------------------------------ */

void core_derivatives(Core *core) { (void)core; }

int core_forward(Core *core, int starting) {
    (void)starting;
    core_message(core, ERROR, "a model written by hand has no derivatives");
    return 0;
}

double core_next_event(Core *core) {
    (void)core;
    return INFINITY;
}
