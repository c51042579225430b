/* SPDX-License-Identifier: Apache-2.0 */
/* The shape functions of a graded grid of quadrilaterals or hexahedra at points: what mesh.py
 * (_interval, _drifted_interval, locate) and model.py (_tensor_product) do in forty calls of
 * numpy, to the bit. Arrays come by the buffer protocol, row-major.
 */
#include "../_buffers.h"

/* Grid lines of one direction; where they drift, one stands at `at + drift * depth`. */
typedef struct {
    const double *at, *drift;
    int count;
} Lines;

static double line(const Lines *lines, int i, double depth)
{
    return lines->drift == NULL ? lines->at[i] : lines->at[i] + lines->drift[i] * depth;
}

/* Find between which lines a value is, and where between them, 0 to 1. */
static int interval(const Lines *lines, double value, double depth, double *part, char *inside)
{
    int low = 0, high = lines->count; /* the lines before `low` are not beyond the value */
    double slack = 1e-9 * (lines->at[lines->count - 1] - lines->at[0]);
    if (!(value >= line(lines, 0, depth) - slack &&
          value <= line(lines, lines->count - 1, depth) + slack))
        *inside = 0;
    while (low < high) {
        int middle = (low + high) / 2;
        if (line(lines, middle, depth) <= value)
            low = middle + 1;
        else
            high = middle;
    }
    int index = low - 1;
    index = index < 0 ? 0 : index > lines->count - 2 ? lines->count - 2 : index;
    double left = line(lines, index, depth);
    double at = (value - left) / (line(lines, index + 1, depth) - left);
    *part = at < 0.0 ? 0.0 : at > 1.0 ? 1.0 : at;
    return index;
}

/* Lagrange's polynomials of one direction. */
static void polynomials(int quadratic, double at, double *values)
{
    if (quadratic) {
        values[0] = (1 - at) * (1 - 2 * at);
        values[1] = 4 * at * (1 - at);
        values[2] = at * (2 * at - 1);
    } else {
        values[0] = 1 - at;
        values[1] = at;
    }
}

enum {
    IN_POINTS, IN_LATERAL, IN_LEVELS, IN_ORDER, IN_CELLS, OUT_NODES, OUT_VALUES, OUT_INSIDE,
    ARGUMENTS
};

typedef struct {
    Lines lines[3];
    const double *points;
    const Py_ssize_t *order; /* (d, b): which polynomial of each direction makes a function */
    const int *cells;        /* (b, cells): nodes */
    Py_ssize_t *nodes;
    double *values;
    char *inside;
    int d, count, each, quadratic, number;
} Grid;

static int take(Grid *g, Buffers *all, PyObject *const *arguments)
{
    PyObject *lateral = arguments[IN_LATERAL];
    if (!PyTuple_Check(lateral) || PyTuple_GET_SIZE(lateral) < 1 || PyTuple_GET_SIZE(lateral) > 2) {
        PyErr_SetString(PyExc_ValueError, "lateral: not one or two directions");
        return -1;
    }
    g->d = (int)PyTuple_GET_SIZE(lateral) + 1;
    TAKE(g->points, IN_POINTS, "d", 0, 0)
    g->count = TAKEN(double) / g->d;
    int cells = 1;
    for (int a = 0; a < g->d; a++) {
        PyObject *at = arguments[IN_LEVELS], *drift = Py_None;
        if (a < g->d - 1 && !PyArg_ParseTuple(PyTuple_GET_ITEM(lateral, a), "OO", &at, &drift))
            return -1;
        g->lines[a].drift = NULL;
        if ((g->lines[a].at = array(all, at, "d", 2, 0, "lines")) == NULL)
            return -1;
        g->lines[a].count = TAKEN(double);
        cells *= g->lines[a].count - 1;
        if (drift != Py_None &&
            (g->lines[a].drift = array(all, drift, "d", g->lines[a].count, 0, "drift")) == NULL)
            return -1;
    }
    TAKE(g->order, IN_ORDER, "l", g->d, 0)
    g->each = TAKEN(Py_ssize_t) / g->d;
    g->quadratic = g->each == (g->d == 2 ? 9 : 27);
    for (int b = 0; b < g->d * g->each; b++)
        if (g->order[b] < 0 || g->order[b] > 1 + g->quadratic) {
            PyErr_SetString(PyExc_ValueError, "order: not the polynomials of such a cell");
            return -1;
        }
    TAKE(g->cells, IN_CELLS, "i", (Py_ssize_t)cells * g->each, 0)
    g->number = TAKEN(int) / g->each;
    TAKE(g->nodes, OUT_NODES, "l", (Py_ssize_t)g->count * g->each, 1)
    TAKE(g->values, OUT_VALUES, "d", (Py_ssize_t)g->count * g->each, 1)
    TAKE(g->inside, OUT_INSIDE, "?", g->count, 1)
    return 0;
}

static PyObject *shape_functions(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    (void)module;
    Buffers all = {.count = 0};
    Grid g;
    if (given != ARGUMENTS) {
        PyErr_Format(PyExc_TypeError, "%d arguments, not %zd", ARGUMENTS, given);
        return NULL;
    }
    if (take(&g, &all, arguments) < 0) {
        release(&all);
        return NULL;
    }
    int d = g.d;
    for (int k = 0; k < g.count; k++) {
        const double *point = g.points + (Py_ssize_t)k * d;
        double depth = -point[d - 1], lines[3][3] = {{0}};
        int cell = 0;
        g.inside[k] = 1;
        for (int a = d - 1; a >= 0; a--) { /* the layer first, then columns from the last */
            double part;
            int index = interval(&g.lines[a], point[a], depth, &part, &g.inside[k]);
            cell = a == d - 1 ? index : cell * (g.lines[a].count - 1) + index;
            polynomials(g.quadratic, part, lines[a]);
        }
        for (int b = 0; b < g.each; b++) {
            double value = lines[0][g.order[b]];
            for (int a = 1; a < d; a++)
                value *= lines[a][g.order[a * g.each + b]];
            g.values[(Py_ssize_t)k * g.each + b] = value;
            g.nodes[(Py_ssize_t)k * g.each + b] = g.cells[(Py_ssize_t)b * g.number + cell];
        }
    }
    release(&all);
    Py_RETURN_NONE;
}

static PyMethodDef methods[] = {
    {"shape_functions", (PyCFunction)(void (*)(void))shape_functions, METH_FASTCALL,
     "Write nodes, shape functions, and whether it is inside, for each point."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "_grid", .m_size = -1, .m_methods = methods,
};

PyMODINIT_FUNC PyInit__grid(void)
{
    return PyModule_Create(&definition);
}
