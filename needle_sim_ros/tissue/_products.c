/* SPDX-License-Identifier: Apache-2.0 */
/* A matrix times a vector, without letting other threads in meanwhile. */
#include "../_linear_algebra.h"

#define ARGUMENTS 3

/* Return whether a buffer holds doubles in so many dimensions; with an exception if not. */
static int doubles(const Py_buffer *view, int dimensions, const char *name)
{
    if (view->ndim == dimensions && view->format != NULL && strcmp(view->format, "d") == 0)
        return 1;
    PyErr_Format(PyExc_ValueError, "%s: not doubles in %d dimensions", name, dimensions);
    return 0;
}

static int multiply(const Py_buffer *matrix, const Py_buffer *vector, double *out)
{
    const Py_ssize_t item = sizeof(double);
    int rows = (int)matrix->shape[0], columns = (int)matrix->shape[1], one = 1;
    Py_ssize_t down = matrix->strides[0], across = matrix->strides[1];
    double *x = vector->buf, unit = 1.0, zero = 0.0;
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
    Py_buffer matrix, vector, out;
    int fits = 0;
    if (given != ARGUMENTS) {
        PyErr_Format(PyExc_TypeError, "%d arguments, not %zd", ARGUMENTS, given);
        return NULL;
    }
    if (PyObject_GetBuffer(arguments[0], &matrix, PyBUF_STRIDED_RO | PyBUF_FORMAT) < 0)
        return NULL;
    if (PyObject_GetBuffer(arguments[1], &vector, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT) < 0)
        goto matrix_only;
    if (PyObject_GetBuffer(arguments[2], &out,
                           PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | PyBUF_WRITABLE) < 0)
        goto both;
    if (doubles(&matrix, 2, "matrix") && doubles(&vector, 1, "vector") && doubles(&out, 1, "out")) {
        fits = matrix.shape[1] == vector.shape[0] && matrix.shape[0] == out.shape[0];
        if (fits)
            multiply(&matrix, &vector, out.buf);
        else
            PyErr_Format(PyExc_ValueError, "%zd x %zd times %zd is not %zd", matrix.shape[0],
                         matrix.shape[1], vector.shape[0], out.shape[0]);
    }
    PyBuffer_Release(&out);
both:
    PyBuffer_Release(&vector);
matrix_only:
    PyBuffer_Release(&matrix);
    if (!fits)
        return NULL;
    Py_RETURN_NONE;
}

static PyMethodDef methods[] = {
    {"product_into", (PyCFunction)(void (*)(void))product_into, METH_FASTCALL,
     "Write the product of a matrix and a vector into a vector."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "_products", .m_size = -1, .m_methods = methods,
};

PyMODINIT_FUNC PyInit__products(void)
{
    return find_functions() < 0 ? NULL : PyModule_Create(&definition);
}
