/* SPDX-License-Identifier: Apache-2.0 */
/* Waiting without sleeping, and without the interpreter lock. */
#define PY_SSIZE_T_CLEAN
#define _GNU_SOURCE /* SCHED_IDLE, and which processors a thread may use */
#include <Python.h>
#include <errno.h>
#include <sched.h>
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

#ifdef SCHED_IDLE
/* Wait on a processor until a byte is no longer 0, whoever else wants it going first. */
static int yield_on(int core, const volatile char *over)
{
    struct sched_param none = {.sched_priority = 0};
    cpu_set_t only;
    CPU_ZERO(&only);
    CPU_SET(core, &only);
    if (sched_setaffinity(0, sizeof only, &only) < 0 ||
        sched_setscheduler(0, SCHED_IDLE, &none) < 0)
        return errno;
    while (!*over)
        for (int i = 0; i < LOOKS; i++)
            pause_a_little();
    /* who waits for the interpreter lock at this precedence would get it, and keep others from it */
    return sched_setscheduler(0, SCHED_OTHER, &none) < 0 ? errno : 0;
}
#else
static int yield_on(int core, const volatile char *over)
{
    (void)core, (void)over;
    return ENOSYS;
}
#endif

static PyObject *stay_awake(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    (void)module;
    Py_buffer over;
    if (given != 2)
        return PyErr_Format(PyExc_TypeError, "2 arguments, not %zd", given);
    long core = PyLong_AsLong(arguments[0]);
    if (core == -1 && PyErr_Occurred())
        return NULL;
    if (core < 0 || core >= CPU_SETSIZE)
        return PyErr_Format(PyExc_ValueError, "processor %ld", core);
    if (PyObject_GetBuffer(arguments[1], &over, PyBUF_WRITABLE) < 0)
        return NULL;
    int failed = 0;
    if (over.len < 1)
        PyErr_SetString(PyExc_ValueError, "no byte to wait for");
    else {
        Py_BEGIN_ALLOW_THREADS;
        failed = yield_on((int)core, over.buf);
        Py_END_ALLOW_THREADS;
    }
    PyBuffer_Release(&over);
    if (failed) {
        errno = failed;
        PyErr_SetFromErrno(PyExc_OSError);
    }
    if (PyErr_Occurred())
        return NULL;
    Py_RETURN_NONE;
}

static PyMethodDef methods[] = {
    {"stay_awake", (PyCFunction)(void (*)(void))stay_awake, METH_FASTCALL,
     "Keep a processor awake, behind everybody else, until a byte is no longer 0."},
    {"wait_awake", (PyCFunction)(void (*)(void))wait_awake, METH_FASTCALL,
     "Wait for a time, s, asleep for the first part of it, s."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "_wait", .m_size = -1, .m_methods = methods,
};

PyMODINIT_FUNC PyInit__wait(void) { return PyModule_Create(&definition); }
