/* SPDX-License-Identifier: Apache-2.0 */
/* Waiting without sleeping, and without the interpreter lock. */
#define PY_SSIZE_T_CLEAN
#define _POSIX_C_SOURCE 200809L
#include <Python.h>
#include <time.h>

#define LOOKS 20 /* pauses between two looks at the clock */

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

/* Tell the processor that nothing happens here: its other half may have the time. */
static inline void pause_a_little(void)
{
#if defined(__x86_64__) || defined(__i386__)
    __builtin_ia32_pause();
#elif defined(__aarch64__)
    __asm__ volatile("yield");
#endif
}

static PyObject *wait_awake(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    (void)module;
    if (given != 2) {
        PyErr_Format(PyExc_TypeError, "2 arguments, not %zd", given);
        return NULL;
    }
    double end = now(), rest = PyFloat_AsDouble(arguments[1]);
    double length = PyFloat_AsDouble(arguments[0]);
    if (PyErr_Occurred())
        return NULL;
    end += length;
    Py_BEGIN_ALLOW_THREADS;
    if (rest > 0.0 && rest < length && rest < 1.0) {
        struct timespec asleep = {0, (long)(1e9 * rest)};
        nanosleep(&asleep, NULL);
    }
    while (now() < end)
        for (int i = 0; i < LOOKS; i++)
            pause_a_little();
    Py_END_ALLOW_THREADS;
    Py_RETURN_NONE;
}

static PyMethodDef methods[] = {
    {"wait_awake", (PyCFunction)(void (*)(void))wait_awake, METH_FASTCALL,
     "Wait for a time, s, asleep for the first part of it, s."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "_wait", .m_size = -1, .m_methods = methods,
};

PyMODINIT_FUNC PyInit__wait(void) { return PyModule_Create(&definition); }
