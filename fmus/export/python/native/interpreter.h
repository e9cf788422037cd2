/* The functions of Python that the library uses, all of the stable ABI. None is linked: they are looked up in the
   process, or in a Python that is loaded if the process has none. So the library can be loaded on every machine and
   can report that Python is missing. */

#ifndef INTERPRETER_H
#define INTERPRETER_H

#include <stddef.h>

typedef struct PyObject PyObject;

#define PYTHON(X)                                                              \
    X(int, Py_IsInitialized, (void))                                           \
    X(void, Py_InitializeEx, (int))                                            \
    X(void *, PyEval_SaveThread, (void))                                       \
    X(int, PyGILState_Ensure, (void))                                          \
    X(void, PyGILState_Release, (int))                                         \
    X(PyObject *, PyErr_Occurred, (void))                                      \
    X(int, PyErr_ExceptionMatches, (PyObject *))                               \
    X(void, PyErr_Clear, (void))                                               \
    X(void, PyErr_SetInterrupt, (void))                                        \
    X(void, Py_DecRef, (PyObject *))                                           \
    X(PyObject *, PyImport_AddModule, (const char *))                          \
    X(PyObject *, PyModule_GetDict, (PyObject *))                              \
    X(PyObject *, Py_CompileString, (const char *, const char *, int))         \
    X(PyObject *, PyEval_EvalCode, (PyObject *, PyObject *, PyObject *))       \
    X(PyObject *, PyDict_GetItemString, (PyObject *, const char *))            \
    X(PyObject *, PyObject_CallFunction, (PyObject *, const char *, ...))      \
    X(PyObject *, PyObject_CallMethod, (PyObject *, const char *, const char *, ...)) \
    X(PyObject *, PyBytes_FromStringAndSize, (const char *, ptrdiff_t))        \
    X(char *, PyBytes_AsString, (PyObject *))                                  \
    X(ptrdiff_t, PyBytes_Size, (PyObject *))                                   \
    X(const char *, PyUnicode_AsUTF8AndSize, (PyObject *, ptrdiff_t *))

typedef struct {
#define MEMBER(type, name, arguments) type(*name) arguments;
    PYTHON(MEMBER)
#undef MEMBER
    PyObject **PyExc_KeyboardInterrupt;
} Interpreter;

static Interpreter py;

/* Finds and starts Python; null, or a message if Python is missing. */
static const char *interpreter_start(void);

#endif
