/* SPDX-License-Identifier: Apache-2.0 */
/* Sums of products, without letting other threads in meanwhile. */
#include "../_linear_algebra.h"

#define NUMBER (sizeof(Py_ssize_t) == sizeof(long) ? "l" : "q") /* numpy's intp */

/* Return whether a buffer holds doubles in so many dimensions; with an exception if not. */
static int doubles(const Py_buffer *view, int dimensions, const char *name)
{
    if (view->ndim == dimensions && view->format != NULL && strcmp(view->format, "d") == 0)
        return 1;
    PyErr_Format(PyExc_ValueError, "%s: not doubles in %d dimensions", name, dimensions);
    return 0;
}

/* Take a matrix of doubles as it lies in memory, before all other arrays; NULL if it is none. */
static const Py_buffer *matrix_in(Buffers *all, PyObject *object)
{
    Py_buffer *view = &all->held[0];
    if (PyObject_GetBuffer(object, view, PyBUF_STRIDED_RO | PyBUF_FORMAT) < 0)
        return NULL;
    all->count = 1;
    return doubles(view, 2, "matrix") ? view : NULL;
}

static int multiply(Buffers *all, PyObject *const *arguments)
{
    const Py_ssize_t item = sizeof(double);
    const Py_buffer *matrix = matrix_in(all, arguments[0]);
    double *x, *out, unit = 1.0, zero = 0.0;
    if (matrix == NULL)
        return -1;
    TAKE(x, 1, "d", 0, 0)
    const Py_buffer *vector = &all->held[1];
    TAKE(out, 2, "d", 0, 1)
    const Py_buffer *target = &all->held[2];
    if (!doubles(vector, 1, "vector") || !doubles(target, 1, "out"))
        return -1;
    if (matrix->shape[1] != vector->shape[0] || matrix->shape[0] != target->shape[0]) {
        PyErr_Format(PyExc_ValueError, "%zd x %zd times %zd is not %zd", matrix->shape[0],
                     matrix->shape[1], vector->shape[0], target->shape[0]);
        return -1;
    }
    int rows = (int)matrix->shape[0], columns = (int)matrix->shape[1], one = 1;
    Py_ssize_t down = matrix->strides[0], across = matrix->strides[1];
    memset(out, 0, (size_t)rows * sizeof(double));
    if (rows == 0 || columns == 0)
        return 0;
    if (across == item && down >= columns * item && down % item == 0) {
        int width = (int)(down / item);
        gemv("T", &columns, &rows, &unit, matrix->buf, &width, x, &one, &zero, out, &one);
    } else if (down == item && across >= rows * item && across % item == 0) {
        int width = (int)(across / item);
        gemv("N", &rows, &columns, &unit, matrix->buf, &width, x, &one, &zero, out, &one);
    } else {
        for (int i = 0; i < rows; i++)
            for (int j = 0; j < columns; j++)
                out[i] += x[j] * *(double *)((char *)matrix->buf + i * down + j * across);
    }
    return 0;
}

static PyObject *product_into(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    (void)module;
    return done(multiply, 3, arguments, given);
}

/* Add up rows of a matrix, one after the other: the same bits whichever columns are wanted. */
static int add_up(Buffers *all, PyObject *const *arguments)
{
    const Py_buffer *view = matrix_in(all, arguments[0]);
    Py_ssize_t *rows, low = view == NULL ? -1 : PyLong_AsSsize_t(arguments[3]);
    double *weights, *out;
    if (view == NULL || (low == -1 && PyErr_Occurred()))
        return -1;
    TAKE(rows, 1, NUMBER, 0, 0)
    int count = TAKEN(Py_ssize_t);
    TAKE(weights, 2, "d", count, 0)
    TAKE(out, 4, "d", 0, 1)
    Py_ssize_t width = TAKEN(double), down = view->strides[0], across = view->strides[1];
    if (low < 0 || low + width > view->shape[1]) {
        PyErr_Format(PyExc_ValueError, "columns %zd to %zd of %zd", low, low + width,
                     view->shape[1]);
        return -1;
    }
    for (int k = 0; k < count; k++)
        if (rows[k] < 0 || rows[k] >= view->shape[0]) {
            PyErr_Format(PyExc_ValueError, "row %zd of %zd", rows[k], view->shape[0]);
            return -1;
        }
    memset(out, 0, (size_t)width * sizeof(double));
    const char *from = (char *)view->buf + low * across;
    if (across == (Py_ssize_t)sizeof(double)) {
        for (int k = 0; k < count; k++)
            for (Py_ssize_t i = 0; i < width; i++)
                out[i] += weights[k] * ((double *)(from + rows[k] * down))[i];
    } else {
        for (Py_ssize_t i = 0; i < width; i++)
            for (int k = 0; k < count; k++)
                out[i] += weights[k] * *(double *)(from + rows[k] * down + i * across);
    }
    return 0;
}

static PyObject *rows_into(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    (void)module;
    return done(add_up, 5, arguments, given);
}

/* Read a field of vectors at places and add up what belongs together. */
static int sample(Buffers *all, PyObject *const *arguments)
{
    double *field, *weights, *out;
    Py_ssize_t *places, *starts;
    TAKE(field, 0, "d", 0, 0)
    Py_ssize_t size = TAKEN(double);
    TAKE(places, 1, NUMBER, 0, 0)
    Py_ssize_t count = TAKEN(Py_ssize_t);
    TAKE(weights, 2, "d", count, 0)
    TAKE(starts, 3, NUMBER, 0, 0)
    Py_ssize_t groups = TAKEN(Py_ssize_t);
    TAKE(out, 4, "d", groups, 1)
    Py_ssize_t wide = groups == 0 ? 1 : TAKEN(double) / groups;
    memset(out, 0, (size_t)(groups * wide) * sizeof(double));
    for (Py_ssize_t group = 0; group < groups; group++) {
        Py_ssize_t end = group + 1 < groups ? starts[group + 1] : count;
        if (starts[group] < 0 || end > count) {
            PyErr_Format(PyExc_ValueError, "places %zd to %zd of %zd", starts[group], end, count);
            return -1;
        }
        for (Py_ssize_t j = starts[group]; j < end; j++) {
            if (places[j] < 0 || wide * (places[j] + 1) > size) {
                PyErr_Format(PyExc_ValueError, "place %zd of %zd", places[j], size / wide);
                return -1;
            }
            for (Py_ssize_t b = 0; b < wide; b++)
                out[group * wide + b] += weights[j] * field[wide * places[j] + b];
        }
    }
    return 0;
}

static PyObject *samples_into(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    (void)module;
    return done(sample, 5, arguments, given);
}

static PyMethodDef methods[] = {
    {"product_into", (PyCFunction)(void (*)(void))product_into, METH_FASTCALL,
     "Write the product of a matrix and a vector into a vector."},
    {"rows_into", (PyCFunction)(void (*)(void))rows_into, METH_FASTCALL,
     "Write the weighted sum of rows of a matrix, from a column on, into a vector."},
    {"samples_into", (PyCFunction)(void (*)(void))samples_into, METH_FASTCALL,
     "Write the weighted sums of a field at groups of places into a vector."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "_products", .m_size = -1, .m_methods = methods,
};

PyMODINIT_FUNC PyInit__products(void)
{
    return find_functions() < 0 ? NULL : PyModule_Create(&definition);
}
