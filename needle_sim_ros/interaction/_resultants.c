/* SPDX-License-Identifier: Apache-2.0 */
/* What the forces along a needle add up to; resultants.py says of what. */
#include "../_buffers.h"

#define MOST_AXES 3

/* Add up; -1 with an exception. `out` has four moments and a rubbing for each lateral axis, then
   the friction, that of it beyond the held points, and the twist. */
static int add_up(Buffers *all, PyObject *const *arguments, double *out, int *axes)
{
    double *s, *q, *f, *softness, *points, *moved, *lateral, origin[MOST_AXES];
    TAKE(s, 0, "d", 0, 0)
    int held = TAKEN(double);
    TAKE(q, 1, "d", 0, 0)
    int m = all->held[all->count - 1].ndim == 2 ? (int)all->held[all->count - 1].shape[0] : 0;
    if (m < 1 || m >= MOST_AXES || TAKEN(double) != m * held) {
        PyErr_Format(PyExc_ValueError, "q: not one or two rows of %d forces", held);
        return -1;
    }
    int d = m + 1;
    TAKE(f, 2, "d", 0, 0)
    int active = TAKEN(double);
    TAKE(softness, 3, "d", held, 0)
    TAKE(points, 4, "d", (Py_ssize_t)held * d, 0)
    TAKE(moved, 5, "d", (Py_ssize_t)held * d, 0)
    TAKE(lateral, 6, "d", m * d, 0)
    if (brief(arguments[7], d, origin) < 0)
        return -1;
    *axes = m;
    memset(out, 0, (size_t)(5 * m + 3) * sizeof(double));
    for (int k = 0; k < held; k++) {
        double bent[MOST_AXES];
        for (int a = 0; a < m; a++) {
            double force = q[a * held + k], *sums = out + 5 * a;
            sums[0] += force;
            sums[1] += force * s[k];
            sums[2] += force * (s[k] * s[k]);
            sums[3] += force * (s[k] * s[k] * s[k]);
            bent[a] = softness[k] * force;
            for (int i = 0; i < d; i++)
                bent[a] += lateral[a * d + i] * (points[k * d + i] + moved[k * d + i] - origin[i]);
            if (k < active)
                sums[4] += bent[a] * f[k];
        }
        if (m == 2)
            out[5 * m + 2] += bent[1] * q[k] - bent[0] * q[held + k];
    }
    for (int k = 0; k < active; k++)
        out[5 * m + (k < held ? 0 : 1)] += f[k];
    out[5 * m] += out[5 * m + 1];
    return 0;
}

static PyObject *resultants(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    (void)module;
    Buffers all = {.count = 0};
    double out[5 * MOST_AXES + 3];
    int axes = 0;
    if (given != 8)
        return PyErr_Format(PyExc_TypeError, "8 arguments, not %zd", given);
    int failed = add_up(&all, arguments, out, &axes) < 0;
    release(&all);
    if (failed)
        return NULL;
    PyObject *found = PyTuple_New(5 * axes + 3);
    for (int i = 0; found != NULL && i < 5 * axes + 3; i++) {
        PyObject *number = PyFloat_FromDouble(out[i]);
        if (number == NULL)
            Py_CLEAR(found);
        else
            PyTuple_SET_ITEM(found, i, number);
    }
    return found;
}

static PyMethodDef methods[] = {
    {"resultants", (PyCFunction)(void (*)(void))resultants, METH_FASTCALL,
     "Return what the forces along a needle add up to."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "_resultants", .m_size = -1, .m_methods = methods,
};

PyMODINIT_FUNC PyInit__resultants(void)
{
    return PyModule_Create(&definition);
}
