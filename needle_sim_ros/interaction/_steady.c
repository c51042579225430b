/* SPDX-License-Identifier: Apache-2.0 */
/* The balance of a needle that goes on sliding, in one call: what balance.py, sliding.py,
 * spreading.py and lateral_hold.py do in a hundred calls of numpy, in their order and with their
 * names. Linear algebra is scipy's BLAS and LAPACK, found through scipy.linalg.cython_blas and
 * cython_lapack. Where a point or the tip leaves its bound, the answer is None and Python solves
 * the problem in full. Arrays come by the buffer protocol, row-major.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <float.h>
#include <math.h>
#include <string.h>

typedef void (*gemv_t)(char *, int *, int *, double *, double *, int *, double *, int *, double *,
                       double *, int *);
typedef void (*potrs_t)(char *, int *, int *, double *, int *, double *, int *, int *);
typedef void (*gesv_t)(int *, int *, double *, int *, int *, double *, int *, int *);

static gemv_t gemv;
static potrs_t potrs;
static gesv_t gesv;

#define LEAST 1e-6 /* as in spreading.py */
#define MOST_ARRAYS 32

/* Buffers in use, released together. */
typedef struct {
    Py_buffer held[MOST_ARRAYS];
    int count;
} Buffers;

static void release(Buffers *all)
{
    while (all->count > 0)
        PyBuffer_Release(&all->held[--all->count]);
}

/* Return a contiguous array of at least so many items of a kind; NULL with an exception if not. */
static void *array(Buffers *all, PyObject *object, const char *kind, Py_ssize_t items,
                   int writable, const char *name)
{
    Py_buffer *view = &all->held[all->count];
    int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (writable ? PyBUF_WRITABLE : 0);
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
static int stride(Buffers *all, Py_ssize_t rows, Py_ssize_t columns, const char *name)
{
    Py_buffer *view = &all->held[all->count - 1];
    if (view->ndim != 2 || view->shape[0] < rows || view->shape[1] < columns) {
        PyErr_Format(PyExc_ValueError, "%s: not a matrix of %zd rows and %zd columns", name, rows,
                     columns);
        return -1;
    }
    return (int)view->shape[1];
}

/* y = A x, with A of rows x columns at a stride. */
static void product(double *matrix, int width, int rows, int columns, double *x, double *y)
{
    double one = 1.0, zero = 0.0;
    int step = 1;
    gemv("T", &columns, &rows, &one, matrix, &width, x, &step, &zero, y, &step);
}

static double dot(const double *x, const double *y, int count)
{
    double sum = 0.0;
    for (int i = 0; i < count; i++)
        sum += x[i] * y[i];
    return sum;
}

/* spreading.py: the first of two points about a depth, and what part of each hat is passed. */
static int about(double passed, int count, double *one, double *two)
{
    int first = (int)passed;
    first = first < 0 ? 0 : first > count - 1 ? count - 1 : first;
    double t = fmin(passed - first, 1.0);
    *one = t < 0 ? 0.5 * (1 + t) * (1 + t) : 1 - 0.5 * (1 - t) * (1 - t);
    t = fmin(passed - first - 1, 1.0);
    *two = t < 0 ? 0.5 * (1 + t) * (1 + t) : 1 - 0.5 * (1 - t) * (1 - t);
    return first;
}

/* spreading.coverage */
static void coverage(double depth, int count, double spacing, double *length)
{
    double one, two;
    int first = about(depth / spacing, count, &one, &two);
    for (int i = 0; i < count; i++)
        length[i] = i < first + 2 ? spacing : 0.0;
    length[first] = spacing * one;
    if (first + 1 < count)
        length[first + 1] = spacing * two;
    length[0] = fmax((first == 0 ? one : 1.0) * spacing - spacing * 0.5, 0.0);
}

/* spreading.tip_share */
static void tip_share(const double *length, int count, double depth, double spread,
                      double spacing, double *share)
{
    int first = 0;
    double one, two, total = 0.0;
    memcpy(share, length, (size_t)count * sizeof(double));
    if (depth > spread) {
        first = about((depth - spread) / spacing, count, &one, &two);
        memset(share, 0, (size_t)first * sizeof(double));
        share[first] -= spacing * (first ? one : fmax(one - 0.5, 0.0));
        if (first + 1 < count)
            share[first + 1] -= spacing * two;
    }
    for (int i = first; i < count; i++)
        total += share[i];
    if (total <= LEAST * spacing) {
        memset(share, 0, (size_t)count * sizeof(double));
        share[0] = 1.0;
        return;
    }
    for (int i = first; i < count; i++)
        share[i] /= total;
}

/* Balance._softness */
static void hold_softness(double depth, int held, double bevel, double spacing, double grip,
                          double *softness)
{
    memset(softness, 0, (size_t)held * sizeof(double));
    int last = held - 1;
    double behind = depth - last * spacing;
    for (; last > 0 && behind < bevel; last--, behind += spacing)
        softness[last] = (bevel / behind - 1.0) / (grip * spacing);
}

/* LateralHold.forces: answer the gaps (m k,) in place by the factor (column-major, its upper
 * half) and what changed since.
 * `work` has room for kinds * (kinds + 1) + (kinds / m)^2 doubles, `pivots` for kinds ints. */
static int answer(int m, int held, double *factor, int kinds, double *kind, double *answers,
                  const double *products, double farther, double rigidity,
                  const double *softness, const double *least, double *gaps, double *work,
                  int *pivots)
{
    int size = m * held, one = 1, info = 0, each = kinds / m, varying = each - 2;
    double *system = work, *load = system + kinds * kinds, *weights = load + kinds;
    potrs("U", &size, &one, factor, &size, gaps, &size, &info);
    if (info != 0)
        return -1;
    double turn = farther / rigidity;
    memset(weights, 0, (size_t)(each * each) * sizeof(double));
    weights[0] = turn;
    weights[1] = weights[each] = turn * farther / 2.0;
    weights[each + 1] = turn * farther * farther / 3.0;
    for (int v = 0; v < varying; v++)
        weights[(v + 2) * (each + 1)] = softness[held - varying + v] - least[v];
    /* the system is made column-major */
    memset(system, 0, (size_t)(kinds * (kinds + 1)) * sizeof(double));
    for (int a = 0; a < m; a++)
        for (int i = 0; i < each; i++) {
            int row = a * each + i;
            for (int j = 0; j < each; j++) {
                double weight = weights[i * each + j];
                if (weight == 0.0)
                    continue;
                const double *from = products + (a * each + j) * kinds;
                for (int c = 0; c < kinds; c++)
                    system[c * kinds + row] += weight * from[c];
                load[row] += weight * dot(kind + (a * each + j) * size, gaps, size);
            }
            system[row * kinds + row] += 1.0;
        }
    gesv(&kinds, &one, system, &kinds, pivots, load, &kinds, &info);
    if (info != 0)
        return -1;
    for (int i = 0; i < kinds; i++)
        for (int c = 0; c < size; c++)
            gaps[c] -= load[i] * answers[i * size + c];
    return 0;
}

/* Copy a short vector, strided or not. */
static int brief(PyObject *object, int count, double *into)
{
    Py_buffer view;
    if (PyObject_GetBuffer(object, &view, PyBUF_STRIDED_RO | PyBUF_FORMAT) < 0)
        return -1;
    int fits = view.ndim == 1 && view.shape[0] == count && strcmp(view.format, "d") == 0;
    for (int i = 0; fits && i < count; i++)
        into[i] = *(double *)((char *)view.buf + i * view.strides[0]);
    PyBuffer_Release(&view);
    if (!fits)
        PyErr_SetString(PyExc_ValueError, "origin: not so many numbers as the tissue has axes");
    return fits ? 0 : -1;
}

enum { /* numbers, in this order */
    DEPTH, ADVANCE, LIMIT, REACH, SPACING, BEVEL, LENGTH, RIGIDITY, GRIP, TIP_SOFTNESS,
    PRESLIDING, WEAKENING, TOLERANCE, NUMBERS
};

enum { /* arguments of solve, in this order */
    IN_NUMBERS, IN_ORIGIN, IN_AXIAL, IN_LATERAL, IN_POINTS, IN_KINETIC, IN_FREE, IN_MOVED,
    IN_SLIP, IN_STRAIN, IN_STATUS, IN_BETWEEN, IN_MIXED, IN_FACTOR, IN_ARCLENGTH, IN_LEAST,
    IN_KINDS, IN_ANSWERS, IN_PRODUCTS, OUT_ROWS, OUT_HOLD, OUT_LATERAL, OUT_FORCES, OUT_MOVED,
    ARGUMENTS
};

enum { /* rows of OUT_ROWS */
    FRICTION, SHARE, STRAIN, SLIP, SLID, LENGTHS, AXIAL_FORCE, ELASTIC, ALONG, ROWS
};

#define TAKE(name, index, kind, items, write)                                                     \
    if ((name = array(&all, arguments[index], kind, items, write, #name)) == NULL)                \
        goto failed;

static PyObject *solve(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    (void)module;
    Buffers all = {.count = 0};
    PyObject *answered = NULL;
    double numbers[NUMBERS], origin[3], *work = NULL;
    double *axial, *lateral, *points, *kinetic, *free_, *moved, *slip, *strain, *between;
    double *mixed[2], *factor, *arclength, *least, *kinds, *answers, *products;
    double *rows, *hold, *q, *forces, *after;
    signed char *status;
    if (given != ARGUMENTS) {
        PyErr_Format(PyExc_TypeError, "%d arguments, not %zd", ARGUMENTS, given);
        return NULL;
    }
    if (!PyTuple_Check(arguments[IN_NUMBERS]) || PyTuple_GET_SIZE(arguments[IN_NUMBERS]) != NUMBERS) {
        PyErr_Format(PyExc_TypeError, "numbers: not a tuple of %d", NUMBERS);
        return NULL;
    }
    for (int i = 0; i < NUMBERS; i++)
        numbers[i] = PyFloat_AsDouble(PyTuple_GET_ITEM(arguments[IN_NUMBERS], i));
    if (PyErr_Occurred())
        return NULL;

    TAKE(axial, IN_AXIAL, "d", 2, 0)
    int d = (int)(all.held[all.count - 1].len / (Py_ssize_t)sizeof(double)), m = d - 1;
    if (d > 3 || !PyTuple_Check(arguments[IN_MIXED]) || PyTuple_GET_SIZE(arguments[IN_MIXED]) != m) {
        PyErr_SetString(PyExc_ValueError, "axial, mixed: 2 or 3 axes, a block for each lateral one");
        goto failed;
    }
    TAKE(status, IN_STATUS, "b", 2, 0)
    int n = (int)all.held[all.count - 1].len - 1;
    TAKE(hold, OUT_HOLD, "d", 2, 1)
    int held = (int)(all.held[all.count - 1].len / (Py_ssize_t)(2 * sizeof(double)));
    TAKE(free_, IN_FREE, "d", n * d, 0)
    int laid = (int)(all.held[all.count - 1].len / (Py_ssize_t)(d * sizeof(double)));
    if (held > n) {
        PyErr_SetString(PyExc_ValueError, "more points are held than rub");
        goto failed;
    }
    int size = m * held;
    if (brief(arguments[IN_ORIGIN], d, origin) < 0)
        goto failed;
    TAKE(lateral, IN_LATERAL, "d", m * d, 0)
    TAKE(points, IN_POINTS, "d", laid * d, 0)
    TAKE(kinetic, IN_KINETIC, "d", n, 0)
    TAKE(moved, IN_MOVED, "d", n * d, 0)
    TAKE(slip, IN_SLIP, "d", n, 0)
    TAKE(strain, IN_STRAIN, "d", n, 0)
    TAKE(between, IN_BETWEEN, "d", 0, 0)
    int wide = stride(&all, laid * d, laid * d, "between");
    if (wide < 0)
        goto failed;
    int mixed_wide[2];
    for (int a = 0; a < m; a++) {
        PyObject *block = PyTuple_GET_ITEM(arguments[IN_MIXED], a);
        if ((mixed[a] = array(&all, block, "d", 0, 0, "mixed")) == NULL ||
            (mixed_wide[a] = stride(&all, held, n, "mixed")) < 0)
            goto failed;
    }
    TAKE(factor, IN_FACTOR, "d", (Py_ssize_t)size * size, 0)
    TAKE(arclength, IN_ARCLENGTH, "d", held, 0)
    TAKE(least, IN_LEAST, "d", 0, 0)
    int count = m * (2 + (int)(all.held[all.count - 1].len / (Py_ssize_t)sizeof(double)));
    if (count > m * (2 + held)) {
        PyErr_SetString(PyExc_ValueError, "least: more points vary than are held");
        goto failed;
    }
    TAKE(kinds, IN_KINDS, "d", count * size, 0)
    TAKE(answers, IN_ANSWERS, "d", count * size, 0)
    TAKE(products, IN_PRODUCTS, "d", count * count, 0)
    TAKE(rows, OUT_ROWS, "d", ROWS * n, 1)
    TAKE(q, OUT_LATERAL, "d", size, 1)
    TAKE(forces, OUT_FORCES, "d", laid * d, 1)
    TAKE(after, OUT_MOVED, "d", laid * d, 1)

    int one_way = status[0], along_tip = status[n] > 0;
    double *friction = rows + FRICTION * n, *share = rows + SHARE * n, *axial_force = rows + AXIAL_FORCE * n;
    double *elastic = rows + ELASTIC * n, *along = rows + ALONG * n, *lengths = rows + LENGTHS * n;
    double depth = numbers[DEPTH], h = numbers[SPACING];
    double tip = along_tip ? numbers[LIMIT] : 0.0;
    for (int i = 0; i < n; i++)
        if (status[i] != one_way || strain[i] * one_way <= 0 || slip[i] < numbers[WEAKENING])
            goto not_steady;
    if (status[n] != one_way || numbers[ADVANCE] * one_way <= 0)
        goto not_steady;

    size_t room = (size_t)(count * (count + 1) + (count / m) * (count / m)) * sizeof(double);
    if ((work = PyMem_Malloc(room + (size_t)count * sizeof(int))) == NULL) {
        PyErr_NoMemory();
        goto failed;
    }
    coverage(depth, n, h, lengths);
    tip_share(lengths, n, depth, numbers[BEVEL], h, share);
    hold_softness(depth, held, numbers[BEVEL], h, numbers[GRIP], hold + held);
    for (int k = 0; k < held; k++)
        hold[k] = h * k + (numbers[LENGTH] - depth);

    double *presliding = rows + STRAIN * n; /* becomes the strain */
    double largest = -DBL_MAX;
    for (int i = 0; i < n; i++) {
        along[i] = dot(free_ + i * d, axial, d);
        elastic[i] = dot(moved + i * d, axial, d) - along[i] + numbers[ADVANCE] + strain[i];
        largest = fmax(largest, elastic[i]);
        presliding[i] = 1.0 / (numbers[PRESLIDING] * fmax(lengths[i], LEAST * h));
        friction[i] = one_way * (kinetic[i] * lengths[i]);
        axial_force[i] = friction[i] + tip * share[i];
    }
    double reach = numbers[REACH] - dot(share, along, n);
    double allowed = numbers[TOLERANCE] * fmax(largest, fabs(reach));

    for (int a = 0; a < m; a++) {
        const double *axis = lateral + a * d;
        product(mixed[a], mixed_wide[a], held, n, axial_force, q + a * held);
        for (int k = 0; k < held; k++) {
            double gap = 0.0;
            for (int i = 0; i < d; i++)
                gap += (origin[i] - (points[k * d + i] + free_[k * d + i])) * axis[i];
            q[a * held + k] = gap - q[a * held + k];
        }
    }
    if (answer(m, held, factor, count, kinds, answers, products, hold[0] - arclength[0],
               numbers[RIGIDITY], hold + held, least, q, work,
               (int *)((char *)work + room)) < 0)
        goto not_steady;

    for (int i = 0; i < n; i++)
        for (int c = 0; c < d; c++) {
            double force = axial_force[i] * axial[c];
            for (int a = 0; a < m && i < held; a++)
                force += q[a * held + i] * lateral[a * d + c];
            forces[i * d + c] = force;
        }
    memset(forces + n * d, 0, (size_t)((laid - n) * d) * sizeof(double));
    product(between, wide, laid * d, n * d, forces, after);

    double overlap = reach - numbers[TIP_SOFTNESS] * tip;
    double *slid = rows + SLID * n, *slipped = rows + SLIP * n;
    for (int i = 0; i < n; i++) {
        double went = dot(after + i * d, axial, d);
        overlap -= share[i] * went;
        presliding[i] *= friction[i];
        slid[i] = elastic[i] - went - presliding[i];
        slipped[i] = slip[i] + fabs(slid[i]);
        if (slid[i] * one_way < -allowed)
            goto not_steady;
    }
    if (!((along_tip ? overlap : -overlap) >= -allowed))
        goto not_steady;
    for (int i = 0; i < laid * d; i++)
        after[i] += free_[i];
    answered = Py_BuildValue("dd", tip, overlap);
    goto failed;

not_steady:
    answered = Py_NewRef(Py_None);
failed:
    PyMem_Free(work);
    release(&all);
    return answered;
}

static void *function(const char *module, const char *name)
{
    void *pointer = NULL;
    PyObject *from = PyImport_ImportModule(module), *table = NULL, *capsule = NULL;
    if (from != NULL && (table = PyObject_GetAttrString(from, "__pyx_capi__")) != NULL &&
        (capsule = PyMapping_GetItemString(table, name)) != NULL)
        pointer = PyCapsule_GetPointer(capsule, PyCapsule_GetName(capsule));
    Py_XDECREF(capsule);
    Py_XDECREF(table);
    Py_XDECREF(from);
    return pointer;
}

static PyMethodDef methods[] = {
    {"solve", (PyCFunction)(void (*)(void))solve, METH_FASTCALL,
     "Solve for a needle that goes on sliding; None where it does not."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "_steady", .m_size = -1, .m_methods = methods,
};

PyMODINIT_FUNC PyInit__steady(void)
{
    gemv = (gemv_t)function("scipy.linalg.cython_blas", "dgemv");
    potrs = (potrs_t)function("scipy.linalg.cython_lapack", "dpotrs");
    gesv = (gesv_t)function("scipy.linalg.cython_lapack", "dgesv");
    if (gemv == NULL || potrs == NULL || gesv == NULL)
        return NULL;
    return PyModule_Create(&definition);
}
