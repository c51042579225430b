/* SPDX-License-Identifier: Apache-2.0 */
/* The messages of a tick in one call; encoding.py and cdr.py say what they are, and make the
 * same bytes. CDR is little-endian, as the machine has to be.
 */
#include "../_buffers.h"
#include <math.h>
#include <stdint.h>

#define SECOND 1000000000LL
#define PLAIN 4                 /* encapsulation; the stamp follows it */
#define WORDS 7                 /* of a point of a cloud: x y z dx dy dz id */
#define OUTPUTS 9

/* Write a time, ns, as seconds and what is left of one; -1 with an exception. */
static int put_stamp(char *message, long long stamp)
{
    long long seconds = stamp / SECOND, rest = stamp % SECOND;
    if (rest < 0) {
        rest += SECOND;
        seconds -= 1;
    }
    if (seconds < INT32_MIN || seconds > INT32_MAX) {
        PyErr_Format(PyExc_OverflowError, "a stamp of %lld s", seconds);
        return -1;
    }
    int32_t whole = (int32_t)seconds;
    uint32_t part = (uint32_t)rest;
    memcpy(message + PLAIN, &whole, sizeof whole);
    memcpy(message + PLAIN + sizeof whole, &part, sizeof part);
    return 0;
}

/* Return what a message begins with, and doubles; the stamp where there is one. */
static PyObject *doubles(PyObject *begin, const long long *stamp, const double *values, int count)
{
    Py_ssize_t known = PyBytes_GET_SIZE(begin), size = count * (Py_ssize_t)sizeof(double);
    PyObject *message = PyBytes_FromStringAndSize(NULL, known + size);
    if (message == NULL)
        return NULL;
    memcpy(PyBytes_AS_STRING(message), PyBytes_AS_STRING(begin), (size_t)known);
    memcpy(PyBytes_AS_STRING(message) + known, values, (size_t)size);
    if (stamp != NULL && put_stamp(PyBytes_AS_STRING(message), *stamp) < 0)
        Py_CLEAR(message);
    return message;
}

/* Return a cloud of markers, (n, 3), that moved, (n, d): in the plane along x and z. */
static PyObject *cloud(Buffers *all, PyObject *blank, long long stamp, PyObject *markers,
                       PyObject *shifts)
{
    double *where = array(all, markers, "d", 0, 0, "markers"), *moved;
    if (where == NULL)
        return NULL;
    Py_ssize_t n = all->held[all->count - 1].len / (3 * (Py_ssize_t)sizeof(double));
    if ((moved = array(all, shifts, "d", 0, 0, "shifts")) == NULL)
        return NULL;
    Py_ssize_t given = all->held[all->count - 1].len / (Py_ssize_t)sizeof(double);
    Py_ssize_t size = PyBytes_GET_SIZE(blank), length = n * WORDS * (Py_ssize_t)sizeof(float);
    int d = given == 3 * n ? 3 : 2;
    if (given != n * d || size < PLAIN + 8 + length + 1) {
        PyErr_Format(PyExc_ValueError, "%zd numbers for %zd markers in %zd bytes", given, n, size);
        return NULL;
    }
    PyObject *message = PyBytes_FromStringAndSize(PyBytes_AS_STRING(blank), size);
    if (message == NULL)
        return NULL;
    char *to = PyBytes_AS_STRING(message) + size - 1 - length; /* one byte follows the points */
    for (Py_ssize_t k = 0; k < n; k++, to += WORDS * sizeof(float)) {
        const double *by = moved + k * d, shift[3] = {by[0], d == 3 ? by[1] : 0.0, by[d - 1]};
        float words[WORDS - 1];
        for (int i = 0; i < 3; i++) {
            words[i] = (float)(where[3 * k + i] + shift[i]);
            words[3 + i] = (float)shift[i];
        }
        memcpy(to, words, sizeof words);
    }
    if (put_stamp(PyBytes_AS_STRING(message), stamp) < 0)
        Py_CLEAR(message);
    return message;
}

/* Quaternion x y z w of the tip: encoding.tip_orientation. */
static void tip_orientation(const double *base, const double *slope, double steep, double *out)
{
    double x = base[0], y = base[1], z = base[2], w = base[3];
    memcpy(out, base, 4 * sizeof(double));
    if (steep == 0.0)
        return;
    double half = atan(steep) / 2, c = cos(half), s = sin(half) / steep;
    double a = -s * slope[1], b = s * slope[0];
    out[0] = w * a + x * c - z * b;
    out[1] = w * b + y * c + z * a;
    out[2] = x * b - y * a + z * c;
    out[3] = w * c - x * a - y * b;
}

/* Copy the numbers of a tuple; -1 with an exception. */
static int numbers(PyObject *tuple, int count, double *into)
{
    if (!PyTuple_Check(tuple) || PyTuple_GET_SIZE(tuple) != count) {
        PyErr_Format(PyExc_TypeError, "readings: not a tuple of %d numbers", count);
        return -1;
    }
    for (int i = 0; i < count; i++)
        into[i] = PyFloat_AsDouble(PyTuple_GET_ITEM(tuple, i));
    return PyErr_Occurred() ? -1 : 0;
}

enum {
    STAMP, PLAIN_BEGIN, TISSUE, BASE, READINGS, STEEP, POSITION, ORIENTATION, DEPTH, TIP, PROCESS,
    BLANK, MARKERS, SHIFTS, ARGUMENTS
};
enum { DEFLECTION, SLOPE, PLACE, FORCE, TORQUE, FRICTION, MEMBERS };

static PyObject *make(Buffers *all, PyObject *const *arguments)
{
    static const int bytes[] = {PLAIN_BEGIN, TISSUE, BASE, PROCESS, BLANK};
    for (size_t i = 0; i < sizeof bytes / sizeof bytes[0]; i++)
        if (!PyBytes_Check(arguments[bytes[i]]) || PyBytes_GET_SIZE(arguments[bytes[i]]) < PLAIN)
            return PyErr_Format(PyExc_TypeError, "argument %d: not bytes of a message", bytes[i]);
    PyObject *const tissue = arguments[TISSUE], *const base = arguments[BASE];
    if (PyBytes_GET_SIZE(tissue) < PLAIN + 8 || PyBytes_GET_SIZE(base) < PLAIN + 8)
        return PyErr_Format(PyExc_ValueError, "a header without room for a stamp");
    long long stamp = PyLong_AsLongLong(arguments[STAMP]);
    if (stamp == -1 && PyErr_Occurred())
        return NULL;
    PyObject *readings = arguments[READINGS];
    if (!PyTuple_Check(readings) || PyTuple_GET_SIZE(readings) != MEMBERS)
        return PyErr_Format(PyExc_TypeError, "readings: not a tuple of %d", MEMBERS);
    double deflection[3], slope[2], tip[7], wrench[6], pose[7];
    if (numbers(PyTuple_GET_ITEM(readings, DEFLECTION), 3, deflection) < 0 ||
        numbers(PyTuple_GET_ITEM(readings, SLOPE), 2, slope) < 0 ||
        numbers(PyTuple_GET_ITEM(readings, PLACE), 3, tip) < 0 ||
        numbers(PyTuple_GET_ITEM(readings, FORCE), 3, wrench) < 0 ||
        numbers(PyTuple_GET_ITEM(readings, TORQUE), 3, wrench + 3) < 0 ||
        brief(arguments[POSITION], 3, pose) < 0 || brief(arguments[ORIENTATION], 4, pose + 3) < 0)
        return NULL;
    double friction = PyFloat_AsDouble(PyTuple_GET_ITEM(readings, FRICTION));
    double steep = PyFloat_AsDouble(arguments[STEEP]), depth = PyFloat_AsDouble(arguments[DEPTH]);
    double pushed = PyFloat_AsDouble(arguments[TIP]);
    if (PyErr_Occurred())
        return NULL;
    tip_orientation(pose + 3, slope, steep, tip + 3);

    PyObject *plain = arguments[PLAIN_BEGIN], *process = arguments[PROCESS];
    PyObject *made[OUTPUTS] = {
        doubles(base, &stamp, deflection, 3),
        doubles(tissue, &stamp, tip, 7),
        doubles(base, &stamp, wrench, 6),
        cloud(all, arguments[BLANK], stamp, arguments[MARKERS], arguments[SHIFTS]),
        doubles(plain, NULL, &depth, 1),
        Py_NewRef(process),
        doubles(tissue, &stamp, pose, 7),
        doubles(plain, NULL, &friction, 1),
        doubles(plain, NULL, &pushed, 1),
    };
    PyObject *outputs = PyTuple_New(OUTPUTS);
    int complete = outputs != NULL;
    for (int i = 0; i < OUTPUTS; i++)
        complete = complete && made[i] != NULL;
    for (int i = 0; i < OUTPUTS; i++)
        if (complete)
            PyTuple_SET_ITEM(outputs, i, made[i]);
        else
            Py_XDECREF(made[i]);
    if (!complete)
        Py_CLEAR(outputs);
    return outputs;
}

static PyObject *outputs(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    (void)module;
    if (given != ARGUMENTS)
        return PyErr_Format(PyExc_TypeError, "%zd arguments, not %d", given, ARGUMENTS);
    Buffers all = {.count = 0};
    PyObject *made = make(&all, arguments);
    release(&all);
    return made;
}

static PyMethodDef methods[] = {
    {"outputs", (PyCFunction)(void (*)(void))outputs, METH_FASTCALL,
     "Return the messages of all outputs of a tick."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "_messages", .m_size = -1, .m_methods = methods,
};

PyMODINIT_FUNC PyInit__messages(void)
{
    const uint16_t one = 1;
    if (*(const unsigned char *)&one != 1) {
        PyErr_SetString(PyExc_ImportError, "only for little-endian machines");
        return NULL;
    }
    return PyModule_Create(&definition);
}
