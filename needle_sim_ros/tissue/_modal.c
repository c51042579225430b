/* SPDX-License-Identifier: Apache-2.0 */
/* A step of reduced dynamics; modal_step.py says what each function does. */
#include "../_linear_algebra.h"

#define NEGLIGIBLE 1e-200 /* of dynamics.py */

/* A matrix whose rows lie in memory one after the other, apart or not. */
typedef struct {
    double *at;
    int rows, columns, width;
} Matrix;

static int matrix(Buffers *all, PyObject *object, const char *name, Matrix *into)
{
    const Py_ssize_t item = sizeof(double);
    Py_buffer *view = &all->held[all->count];
    if (PyObject_GetBuffer(object, view, PyBUF_STRIDED_RO | PyBUF_FORMAT) < 0)
        return -1;
    all->count++;
    int fits = view->ndim == 2 && view->format != NULL && strcmp(view->format, "d") == 0;
    if (fits && view->shape[0] > 0 && view->shape[1] > 0)
        fits = (view->shape[1] == 1 || view->strides[1] == item) &&
               (view->shape[0] == 1 || (view->strides[0] >= view->shape[1] * item &&
                                        view->strides[0] % item == 0));
    if (!fits) {
        PyErr_Format(PyExc_ValueError, "%s: not a matrix of doubles, row by row", name);
        return -1;
    }
    into->at = view->buf;
    into->rows = (int)view->shape[0];
    into->columns = (int)view->shape[1];
    into->width = into->rows > 1 ? (int)(view->strides[0] / item) : into->columns;
    return 0;
}

/* Add the product of the first columns of a matrix and a vector. */
static void add_product(const Matrix *a, double *x, int columns, double *out)
{
    double one = 1.0;
    int step = 1, rows = a->rows, width = a->width > columns ? a->width : columns;
    if (rows > 0 && columns > 0)
        gemv("T", &columns, &rows, &one, a->at, &width, x, &step, &one, out, &step);
}

/* Return nothing for what has decayed to nothing. */
static inline double flushed(double value)
{
    return (value + NEGLIGIBLE) - NEGLIGIBLE;
}

static int check(int holds, const char *what)
{
    if (!holds)
        PyErr_Format(PyExc_ValueError, "%s: sizes that do not fit", what);
    return holds ? 0 : -1;
}

static int unloaded(Buffers *all, PyObject *const *arguments)
{
    double *carry, *modal, *filtered, *forces, *u, *after;
    TAKE(u, 6, "d", 0, 1)
    int modes = TAKEN(double);
    TAKE(carry, 0, "d", (Py_ssize_t)3 * modes, 0)
    TAKE(modal, 1, "d", (Py_ssize_t)3 * modes, 0)
    TAKE(after, 7, "d", 0, 1)
    int count = TAKEN(double);
    TAKE(filtered, 2, "d", count, 0)
    TAKE(forces, 3, "d", count, 0)
    TAKE_NUMBER(kept, 4)
    TAKE_NUMBER(taken, 5)
    for (int i = 0; i < modes; i++)
        u[i] = carry[i] * modal[i] + carry[modes + i] * modal[modes + i] +
               carry[2 * modes + i] * modal[2 * modes + i];
    for (int k = 0; k < count; k++)
        after[k] = kept * filtered[k] + taken * forces[k];
    return 0;
}

static int moved(Buffers *all, PyObject *const *arguments)
{
    Matrix static_part, shapes;
    double *filtered, *u, *out, one = 1.0;
    int step = 1;
    if (matrix(all, arguments[0], "static", &static_part) < 0 ||
        matrix(all, arguments[1], "shapes", &shapes) < 0)
        return -1;
    TAKE(filtered, 2, "d", 0, 0)
    int known = TAKEN(double);
    TAKE(u, 3, "d", 0, 0)
    int modes = TAKEN(double);
    TAKE(out, 4, "d", 0, 1)
    if (check(shapes.rows == modes && shapes.columns == TAKEN(double) &&
                  static_part.rows == shapes.columns, "moved") < 0)
        return -1;
    memset(out, 0, (size_t)shapes.columns * sizeof(double));
    add_product(&static_part, filtered, known < static_part.columns ? known : static_part.columns,
                out);
    if (shapes.rows > 0 && shapes.columns > 0)
        gemv("N", &shapes.columns, &shapes.rows, &one, shapes.at, &shapes.width, u, &step, &one,
             out, &step);
    return 0;
}

static int loaded(Buffers *all, PyObject *const *arguments)
{
    Matrix shapes;
    double *dynamic, *forces, *u, *state, *rates, *filtered, *modal, *after;
    TAKE(u, 3, "d", 0, 0)
    int modes = TAKEN(double);
    TAKE(dynamic, 0, "d", modes, 0)
    if (matrix(all, arguments[1], "shapes", &shapes) < 0)
        return -1;
    TAKE(forces, 2, "d", 0, 0)
    int count = TAKEN(double);
    TAKE(state, 4, "d", (Py_ssize_t)3 * modes, 0)
    TAKE(rates, 5, "d", 8, 0)
    TAKE_NUMBER(share, 6)
    TAKE(filtered, 7, "d", 0, 0)
    int known = TAKEN(double) < count ? TAKEN(double) : count;
    TAKE(modal, 8, "d", (Py_ssize_t)3 * modes, 1)
    TAKE(after, 9, "d", count, 1)
    if (check(shapes.rows == modes && shapes.columns == count, "loaded") < 0)
        return -1;
    memset(modal, 0, (size_t)modes * sizeof(double));
    add_product(&shapes, forces, count, modal);
    for (int i = 0; i < modes; i++) {
        double reached = dynamic[i] * modal[i] + u[i];
        for (int r = 0; r < 2; r++)
            modal[(r + 1) * modes + i] =
                flushed(rates[4 * r] * state[i] + rates[4 * r + 1] * state[modes + i] +
                        rates[4 * r + 2] * state[2 * modes + i] + rates[4 * r + 3] * reached);
        modal[i] = flushed(reached);
    }
    for (int k = 0; k < count; k++)
        after[k] = flushed(share * forces[k] + (k < known ? filtered[k] : 0.0));
    return 0;
}

#define FUNCTION(name, work, count)                                                               \
    static PyObject *name(PyObject *module, PyObject *const *arguments, Py_ssize_t given)         \
    {                                                                                             \
        (void)module;                                                                             \
        return done(work, count, arguments, given);                                               \
    }

FUNCTION(unloaded_into, unloaded, 8)
FUNCTION(moved_into, moved, 5)
FUNCTION(loaded_into, loaded, 10)

static PyMethodDef methods[] = {
    {"unloaded_into", (PyCFunction)(void (*)(void))unloaded_into, METH_FASTCALL,
     "Write modes and filtered forces at the end of a step without load."},
    {"moved_into", (PyCFunction)(void (*)(void))moved_into, METH_FASTCALL,
     "Write the displacement by filtered forces and modes."},
    {"loaded_into", (PyCFunction)(void (*)(void))loaded_into, METH_FASTCALL,
     "Write the state of the modes and the filter at the end of a step."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "_modal", .m_size = -1, .m_methods = methods,
};

PyMODINIT_FUNC PyInit__modal(void)
{
    return find_functions() < 0 ? NULL : PyModule_Create(&definition);
}
