/* SPDX-License-Identifier: Apache-2.0 */
/* scipy's BLAS and LAPACK, found through scipy.linalg.cython_blas and cython_lapack. */
#ifndef NEEDLE_SIM_LINEAR_ALGEBRA_H
#define NEEDLE_SIM_LINEAR_ALGEBRA_H
#include "_buffers.h"

typedef void (*gemv_t)(char *, int *, int *, double *, double *, int *, double *, int *, double *,
                       double *, int *);
typedef void (*potrf_t)(char *, int *, double *, int *, int *);
typedef void (*potrs_t)(char *, int *, int *, double *, int *, double *, int *, int *);
typedef void (*gesv_t)(int *, int *, double *, int *, int *, double *, int *, int *);

static gemv_t gemv;
static potrf_t potrf;
static potrs_t potrs;
static gesv_t gesv;

static void *function(const char *module, const char *name)
{
    void *pointer = NULL;
    const char *kind = NULL;
    PyObject *from = PyImport_ImportModule(module), *table = NULL, *capsule = NULL;
    if (from != NULL && (table = PyObject_GetAttrString(from, "__pyx_capi__")) != NULL &&
        (capsule = PyMapping_GetItemString(table, name)) != NULL)
        kind = PyCapsule_GetName(capsule);
    if (kind != NULL && strstr(kind, "int *") != NULL && strstr(kind, "long") == NULL)
        pointer = PyCapsule_GetPointer(capsule, kind);
    else if (!PyErr_Occurred())
        PyErr_Format(PyExc_ImportError, "%s.%s takes other integers", module, name);
    Py_XDECREF(capsule);
    Py_XDECREF(table);
    Py_XDECREF(from);
    return pointer;
}

/* Look the functions up; -1 with an exception where scipy has them not. */
static int find_functions(void)
{
    gemv = (gemv_t)function("scipy.linalg.cython_blas", "dgemv");
    potrf = (potrf_t)function("scipy.linalg.cython_lapack", "dpotrf");
    potrs = (potrs_t)function("scipy.linalg.cython_lapack", "dpotrs");
    gesv = (gesv_t)function("scipy.linalg.cython_lapack", "dgesv");
    return gemv == NULL || potrf == NULL || potrs == NULL || gesv == NULL ? -1 : 0;
}

/* y = A x, with A of rows x columns at a stride. */
static inline void product(double *matrix, int width, int rows, int columns, double *x, double *y)
{
    double one = 1.0, zero = 0.0;
    int step = 1;
    gemv("T", &columns, &rows, &one, matrix, &width, x, &step, &zero, y, &step);
}

static inline double dot(const double *x, const double *y, int count)
{
    double sum = 0.0;
    for (int i = 0; i < count; i++)
        sum += x[i] * y[i];
    return sum;
}

#endif
