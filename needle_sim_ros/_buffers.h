/* SPDX-License-Identifier: Apache-2.0 */
/* Arrays that Python passes, by the buffer protocol: numpy is not needed to compile. */
#ifndef NEEDLE_SIM_BUFFERS_H
#define NEEDLE_SIM_BUFFERS_H
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <string.h>

#define MOST_ARRAYS 32

/* Buffers in use, released together. */
typedef struct {
    Py_buffer held[MOST_ARRAYS];
    int count;
} Buffers;

static inline void release(Buffers *all)
{
    while (all->count > 0)
        PyBuffer_Release(&all->held[--all->count]);
}

/* Return a contiguous array of at least so many items of a kind; NULL with an exception if not. */
static inline void *array(Buffers *all, PyObject *object, const char *kind, Py_ssize_t items,
                   int writable, const char *name)
{
    Py_buffer *view = &all->held[all->count];
    int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (writable ? PyBUF_WRITABLE : 0);
    if (all->count == MOST_ARRAYS) {
        PyErr_Format(PyExc_SystemError, "%s: more than %d arrays", name, MOST_ARRAYS);
        return NULL;
    }
    if (PyObject_GetBuffer(object, view, flags) < 0)
        return NULL;
    all->count++;
    if (view->format == NULL || strcmp(view->format, kind) != 0 ||
        view->len < items * view->itemsize) {
        PyErr_Format(PyExc_ValueError, "%s: %zd items '%s', not %zd of '%s'", name,
                     view->len / view->itemsize, view->format, items, kind);
        return NULL;
    }
    return view->buf;
}

/* Return the stride of the rows of a matrix with at least so many rows and columns. */
static inline int stride(Buffers *all, Py_ssize_t rows, Py_ssize_t columns, const char *name)
{
    Py_buffer *view = &all->held[all->count - 1];
    if (view->ndim != 2 || view->shape[0] < rows || view->shape[1] < columns) {
        PyErr_Format(PyExc_ValueError, "%s: not a matrix of %zd rows and %zd columns", name, rows,
                     columns);
        return -1;
    }
    return (int)view->shape[1];
}

/* Copy a short vector of so many doubles, strided or not; -1 with an exception if it is not one. */
static inline int brief(PyObject *object, int count, double *into)
{
    Py_buffer view;
    if (PyObject_GetBuffer(object, &view, PyBUF_STRIDED_RO | PyBUF_FORMAT) < 0)
        return -1;
    int fits = view.ndim == 1 && view.shape[0] == count && strcmp(view.format, "d") == 0;
    for (int i = 0; fits && i < count; i++)
        into[i] = *(double *)((char *)view.buf + i * view.strides[0]);
    PyBuffer_Release(&view);
    if (!fits)
        PyErr_Format(PyExc_ValueError, "a vector has not %d numbers, one an axis", count);
    return fits ? 0 : -1;
}

/* Do what a function of Python is for and let go of its arrays; -1 stands for an exception. */
static inline PyObject *done(int (*work)(Buffers *, PyObject *const *), Py_ssize_t wanted,
                             PyObject *const *arguments, Py_ssize_t given)
{
    Buffers all = {.count = 0};
    int failed = given != wanted;
    if (failed)
        PyErr_Format(PyExc_TypeError, "%zd arguments, not %zd", wanted, given);
    else
        failed = work(&all, arguments) < 0;
    release(&all);
    if (failed)
        return NULL;
    Py_RETURN_NONE;
}

/* Take an array in a function that returns -1 with an exception, and tell how long it is. */
#define TAKE(into, index, kind, items, write)                                                     \
    if ((into = array(all, arguments[index], kind, items, write, #into)) == NULL)                 \
        return -1;
#define TAKEN(size) ((int)(all->held[all->count - 1].len / (Py_ssize_t)sizeof(size)))

/* Take a number in such a function. */
#define TAKE_NUMBER(into, index)                                                                  \
    double into = PyFloat_AsDouble(arguments[index]);                                             \
    if (into == -1.0 && PyErr_Occurred())                                                         \
        return -1;

#endif
