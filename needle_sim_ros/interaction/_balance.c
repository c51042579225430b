/* SPDX-License-Identifier: Apache-2.0 */
/* The balance of an inserted needle: what balance.py, friction.py, sliding.py and what they call
 * do in hundreds of calls of numpy, in their order and with their names, in two. `slide` takes
 * all friction to stay at the bound where it was; where that does not hold, or one was free,
 * `bounded` solves the problem in full. The latter answers None where it does not get there, and
 * Python does it all.
 *
 * Arrays come by the buffer protocol, row-major.
 */
#include "../_buffers.h"
#include "_contact_solve.h"
#include "_lateral_hold.h"
#include "_spreading.h"
#include <float.h>
#include <math.h>

#define CREEP 1e-3 /* as in friction.py */

/* Numbers of a step, in this order. */
enum {
    DEPTH, ADVANCE, PACE, LAPSE, DURATION, LIMIT, REACH, SPACING, BEVEL, LENGTH, RIGIDITY, GRIP,
    TIP_SOFTNESS, PRESLIDING, WEAKENING, HEALING, TOLERANCE, NUMBERS
};

/* Rows of numbers, one for each point that rubs: what a step leaves for the state, then what
 * `slide` leaves for `bounded`. */
enum {
    FRICTION, SHARE, STRAIN, SLIP, SLID, LENGTHS, ELASTIC, SOFT, BOUND, AXIAL_FORCE, ALONG, ROWS
};

/* What both functions are given, in this order, and what they make of it. */
enum {
    IN_NUMBERS, IN_ORIGIN, IN_AXIAL, IN_LATERAL, IN_POINTS, IN_FREE, IN_SLIP, IN_STRAIN,
    IN_STATUS, IN_BETWEEN, OUT_ROWS, OUT_HOLD, OUT_LATERAL, OUT_FORCES, OUT_MOVED, COMMON
};

typedef struct {
    double numbers[NUMBERS], origin[3];
    double *axial, *lateral, *points, *free, *slip, *strain, *between;
    double *rows, *arclength, *softness, *q, *forces, *moved;
    signed char *status;
    int d, m, n, held, laid, wide;
} Problem;

static int take(Problem *p, Buffers *all, PyObject *const *arguments)
{
    PyObject *numbers = arguments[IN_NUMBERS];
    if (!PyTuple_Check(numbers) || PyTuple_GET_SIZE(numbers) != NUMBERS) {
        PyErr_Format(PyExc_TypeError, "numbers: not a tuple of %d", NUMBERS);
        return -1;
    }
    for (int i = 0; i < NUMBERS; i++)
        p->numbers[i] = PyFloat_AsDouble(PyTuple_GET_ITEM(numbers, i));
    if (PyErr_Occurred())
        return -1;
    TAKE(p->axial, IN_AXIAL, "d", 2, 0)
    p->d = TAKEN(double);
    p->m = p->d - 1;
    if (p->d > 3) {
        PyErr_SetString(PyExc_ValueError, "axial: 2 or 3 axes");
        return -1;
    }
    TAKE(p->status, IN_STATUS, "b", 2, 0)
    p->n = TAKEN(char) - 1;
    TAKE(p->arclength, OUT_HOLD, "d", 2, 1)
    p->held = TAKEN(double) / 2;
    p->softness = p->arclength + p->held;
    TAKE(p->free, IN_FREE, "d", p->n * p->d, 0)
    p->laid = TAKEN(double) / p->d;
    if (p->held > p->n) {
        PyErr_SetString(PyExc_ValueError, "more points are held than rub");
        return -1;
    }
    if (brief(arguments[IN_ORIGIN], p->d, p->origin) < 0)
        return -1;
    TAKE(p->lateral, IN_LATERAL, "d", p->m * p->d, 0)
    TAKE(p->points, IN_POINTS, "d", p->laid * p->d, 0)
    TAKE(p->slip, IN_SLIP, "d", p->n, 0)
    TAKE(p->strain, IN_STRAIN, "d", p->n, 0)
    TAKE(p->between, IN_BETWEEN, "d", 0, 0)
    if ((p->wide = stride(all, p->laid * p->d, p->laid * p->d, "between")) < 0)
        return -1;
    TAKE(p->rows, OUT_ROWS, "d", ROWS * p->n, 1)
    TAKE(p->q, OUT_LATERAL, "d", p->m * p->held, 1)
    TAKE(p->forces, OUT_FORCES, "d", p->laid * p->d, 1)
    TAKE(p->moved, OUT_MOVED, "d", p->laid * p->d, 1)
    return 0;
}

/* Gap between a held point without forces and the straight needle, along a lateral axis. */
static double gap(const Problem *p, int k, int a)
{
    double sum = 0.0;
    for (int i = 0; i < p->d; i++)
        sum += (p->origin[i] - (p->points[k * p->d + i] + p->free[k * p->d + i])) *
               p->lateral[a * p->d + i];
    return sum;
}

/* Forces in mesh coordinates, and the displacement by them. */
static void act(Problem *p)
{
    const double *axial_force = p->rows + AXIAL_FORCE * p->n;
    int d = p->d;
    for (int i = 0; i < p->n; i++)
        for (int c = 0; c < d; c++) {
            double force = axial_force[i] * p->axial[c];
            for (int a = 0; a < p->m && i < p->held; a++)
                force += p->q[a * p->held + i] * p->lateral[a * d + c];
            p->forces[i * d + c] = force;
        }
    memset(p->forces + p->n * d, 0, (size_t)((p->laid - p->n) * d) * sizeof(double));
    product(p->between, p->wide, p->laid * d, p->n * d, p->forces, p->moved);
}

/* The displacement is that of the tissue, no longer that by the forces alone. */
static void with_free(Problem *p)
{
    for (int i = 0; i < p->laid * p->d; i++)
        p->moved[i] += p->free[i];
}

/* friction.slip_after, of a point */
static double slip_after(const Problem *p, double slip, int status, double slid)
{
    double whole = p->numbers[WEAKENING], healing = p->numbers[DURATION] / p->numbers[HEALING];
    double way = status != 0 ? fabs(slid) : 0.0;
    double heals = healing / (1.0 + way / (CREEP * whole * healing));
    if (slip >= whole && way >= whole * heals)
        return whole;
    return fmin(slip * exp(-heals) - way * expm1(-heals) / heals, whole);
}

static void remember(Problem *p, const signed char *status)
{
    double *rows = p->rows;
    for (int i = 0; i < p->n; i++)
        rows[SLIP * p->n + i] = slip_after(p, p->slip[i], status[i], rows[SLID * p->n + i]);
}

enum { /* what `slide` is given besides; no factor: nothing is tried */
    IN_MOVED = COMMON, IN_STATIC, IN_KINETIC, IN_SLID, IN_MIXED, IN_FACTOR, IN_LENGTHS, IN_LEAST,
    IN_KINDS, IN_ANSWERS, IN_PRODUCTS, SLIDE_ARGUMENTS
};

typedef struct {
    double *moved, *fixed, *kinetic, *slid; /* `fixed` is the static limit */
    double *mixed[2], *factor, *arclength, *least, *kinds, *answers, *products;
    int mixed_wide[2], count;
} Guess;

static int take_guess(Guess *g, const Problem *p, Buffers *all, PyObject *const *arguments)
{
    int size = p->m * p->held;
    TAKE(g->moved, IN_MOVED, "d", p->n * p->d, 0)
    TAKE(g->fixed, IN_STATIC, "d", p->n, 0)
    TAKE(g->kinetic, IN_KINETIC, "d", p->n, 0)
    TAKE(g->slid, IN_SLID, "d", p->n, 0)
    if (arguments[IN_FACTOR] == Py_None)
        return 0;
    PyObject *mixed = arguments[IN_MIXED];
    if (!PyTuple_Check(mixed) || PyTuple_GET_SIZE(mixed) != p->m) {
        PyErr_SetString(PyExc_ValueError, "mixed: not a block for each lateral axis");
        return -1;
    }
    for (int a = 0; a < p->m; a++) {
        g->mixed[a] = array(all, PyTuple_GET_ITEM(mixed, a), "d", 0, 0, "mixed");
        if (g->mixed[a] == NULL ||
            (g->mixed_wide[a] = stride(all, p->held, p->n, "mixed")) < 0)
            return -1;
    }
    TAKE(g->factor, IN_FACTOR, "d", (Py_ssize_t)size * size, 0)
    TAKE(g->arclength, IN_LENGTHS, "d", p->held, 0)
    TAKE(g->least, IN_LEAST, "d", 0, 0)
    g->count = p->m * (2 + TAKEN(double));
    if (g->count > p->m * (2 + p->held)) {
        PyErr_SetString(PyExc_ValueError, "least: more points vary than are held");
        return -1;
    }
    TAKE(g->kinds, IN_KINDS, "d", g->count * size, 0)
    TAKE(g->answers, IN_ANSWERS, "d", g->count * size, 0)
    TAKE(g->products, IN_PRODUCTS, "d", g->count * g->count, 0)
    return 0;
}

/* What a step is about, whoever solves it: lengths, shares, limits; returns the reach. */
static double set_up(Problem *p, const Guess *g)
{
    const double *number = p->numbers;
    double *rows = p->rows, h = number[SPACING], depth = number[DEPTH];
    double *share = rows + SHARE * p->n, *along = rows + ALONG * p->n;
    double *lengths = rows + LENGTHS * p->n;
    int n = p->n, d = p->d;
    coverage(depth, n, h, lengths);
    tip_share(lengths, n, depth, number[BEVEL], h, share);
    hold_softness(depth, p->held, number[BEVEL], h, number[GRIP], p->softness);
    for (int k = 0; k < p->held; k++)
        p->arclength[k] = h * k + (number[LENGTH] - depth);
    double advance = number[ADVANCE];
    for (int i = 0; i < n; i++) {
        along[i] = dot(p->free + i * d, p->axial, d);
        rows[ELASTIC * n + i] =
            dot(g->moved + i * d, p->axial, d) - along[i] + advance + p->strain[i];
        rows[SOFT * n + i] = 1.0 / (number[PRESLIDING] * fmax(lengths[i], LEAST * h));
        /* friction.limits: what slides goes on, what sticks rests */
        double onward = g->slid[i] * number[p->status[i] * advance > 0 ? PACE : LAPSE];
        double slip = slip_after(p, p->slip[i], p->status[i], onward);
        double left = fmax(1.0 - slip / number[WEAKENING], 0.0);
        rows[BOUND * n + i] = (left * (g->fixed[i] - g->kinetic[i]) + g->kinetic[i]) * lengths[i];
    }
    return number[REACH] - dot(share, along, n);
}

/* What `slide` finds for the tip. */
typedef struct {
    double force, overlap, lack;
    int state, solves;
} Tip;

/* SlidingProblem._pushed: how much the tip wants on, with a force on it; NAN where that cannot
 * be told. */
static double pushed(Problem *p, const Guess *g, double tip, double reach, double *work,
                     int *pivots)
{
    int n = p->n, held = p->held, d = p->d;
    double *rows = p->rows, overlap = reach - p->numbers[TIP_SOFTNESS] * tip;
    const double *share = rows + SHARE * n;
    for (int i = 0; i < n; i++)
        rows[AXIAL_FORCE * n + i] = rows[FRICTION * n + i] + tip * share[i];
    for (int a = 0; a < p->m; a++) {
        product(g->mixed[a], g->mixed_wide[a], held, n, rows + AXIAL_FORCE * n, p->q + a * held);
        for (int k = 0; k < held; k++)
            p->q[a * held + k] = gap(p, k, a) - p->q[a * held + k];
    }
    if (answer(p->m, held, g->factor, g->count, g->kinds, g->answers, g->products,
               p->arclength[0] - g->arclength[0], p->numbers[RIGIDITY], p->softness, g->least,
               p->q, work, pivots) < 0)
        return NAN;
    act(p);
    for (int i = 0; i < n; i++) {
        double went = dot(p->moved + i * d, p->axial, d);
        overlap -= share[i] * went;
        rows[SLID * n + i] = rows[ELASTIC * n + i] - went - rows[STRAIN * n + i];
    }
    return overlap;
}

/* Compliance at the tip along the axis, as the tissue and its own contact have it. */
static double softest(const Problem *p)
{
    const double *share = p->rows + SHARE * p->n;
    double sum = p->numbers[TIP_SOFTNESS];
    for (int i = 0; i < p->n; i++)
        for (int j = 0; share[i] != 0.0 && j < p->n; j++)
            for (int a = 0; share[j] != 0.0 && a < p->d; a++) {
                const double *row = p->between + (size_t)(i * p->d + a) * p->wide + j * p->d;
                sum += share[i] * share[j] * p->axial[a] * dot(row, p->axial, p->d);
            }
    return sum;
}

/* SlidingProblem._lack */
static double lack(const Problem *p, double tip, double softest, double overlap)
{
    return fmax(0.0, p->numbers[LIMIT] - tip) * softest - overlap;
}

/* SlidingProblem.sliding: 1 if the guessed bounds of the friction hold, 0 if not. */
static int at_bounds(Problem *p, const Guess *g, double reach, double *work, int *pivots, Tip *tip)
{
    int n = p->n;
    double *rows = p->rows, limit = p->numbers[LIMIT], largest = -DBL_MAX;
    for (int i = 0; i < n; i++) {
        double force = p->status[i] > 0 ? rows[BOUND * n + i] : -rows[BOUND * n + i];
        rows[FRICTION * n + i] = force;
        rows[STRAIN * n + i] = rows[SOFT * n + i] * force;
        largest = fmax(largest, rows[ELASTIC * n + i]);
    }
    double allowed = p->numbers[TOLERANCE] * fmax(largest, fabs(reach));
    tip->state = p->status[n] < 0 ? -1 : 1;
    tip->force = p->status[n] < 0 ? 0.0 : limit;
    tip->solves = 1;
    tip->overlap = pushed(p, g, tip->force, reach, work, pivots);
    if (tip->state * tip->overlap < -allowed) {
        double first = tip->overlap, force = tip->force;
        tip->state = -tip->state;
        tip->force = limit - force;
        tip->solves = 2;
        tip->overlap = pushed(p, g, tip->force, reach, work, pivots);
        if (tip->state * tip->overlap < -allowed) {
            tip->force += tip->overlap / (tip->overlap - first) * (force - tip->force);
            tip->state = 0;
            tip->solves = 3;
            tip->overlap = pushed(p, g, tip->force, reach, work, pivots);
            if (!(fabs(tip->overlap) <= allowed))
                return 0;
            tip->overlap = 0.0;
        }
    }
    if (isnan(tip->overlap))
        return 0;
    if (tip->state <= 0 && limit > 0.0)
        tip->lack = lack(p, tip->force, softest(p), tip->overlap);
    for (int i = 0; i < n; i++)
        if (!(rows[SLID * n + i] * p->status[i] >= -allowed))
            return 0;
    return 1;
}

static PyObject *slide(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    (void)module;
    if (given != SLIDE_ARGUMENTS) {
        PyErr_Format(PyExc_TypeError, "%d arguments, not %zd", SLIDE_ARGUMENTS, given);
        return NULL;
    }
    Buffers all = {.count = 0};
    Problem p;
    Guess g = {.factor = NULL};
    PyObject *answered = NULL;
    double *work = NULL;
    Tip tip = {.solves = 0};
    if (take(&p, &all, arguments) < 0 || take_guess(&g, &p, &all, arguments) < 0)
        goto end;
    double reach = set_up(&p, &g);
    int holds = 0;
    if (g.factor != NULL && memchr(p.status, 0, (size_t)p.n) == NULL) {
        int count = g.count, each = count / p.m;
        size_t room = (size_t)(count * (count + 1) + each * each) * sizeof(double);
        if ((work = PyMem_Malloc(room + (size_t)count * sizeof(int))) == NULL) {
            PyErr_NoMemory();
            goto end;
        }
        holds = at_bounds(&p, &g, reach, work, (int *)((char *)work + room), &tip);
    }
    if (holds) {
        remember(&p, p.status);
        with_free(&p);
    }
    answered = Py_BuildValue("Oddddii", holds ? Py_True : Py_False, reach, tip.force, tip.overlap,
                             tip.lack, tip.state, tip.solves);
end:
    PyMem_Free(work);
    release(&all);
    return answered;
}

enum { /* what `bounded` is given besides */
    IN_BLOCKS = COMMON, OUT_STATUS, BOUNDED_ARGUMENTS
};

/* Set up the matrix and the bounds of a step; the blocks are those of ResponseTable.along, axis
 * by axis. */
static int assemble(const Problem *p, double reach, PyObject *blocks, Buffers *all, Contact *c)
{
    int m = p->m, k = p->held, n = p->n, wide = m * k, size = c->size;
    const double *share = p->rows + SHARE * n;
    for (int a = 0; a <= m; a++)
        for (int b = 0; b <= a; b++) {
            int rows = a == m ? n : k, columns = b == m ? n : k;
            PyObject *object = PyTuple_GET_ITEM(blocks, a * (a + 1) / 2 + b);
            const double *from = array(all, object, "d", 0, 0, "blocks");
            int across = from == NULL ? -1 : stride(all, rows, columns, "blocks");
            if (across < 0)
                return -1;
            for (int i = 0; i < rows; i++)
                for (int j = 0; j < columns; j++) {
                    double value = from[(size_t)i * across + j];
                    c->matrix[(size_t)(a * k + i) * size + b * k + j] = value;
                    c->matrix[(size_t)(b * k + j) * size + a * k + i] = value;
                }
        }
    for (int a = 0; a < m; a++)
        for (int i = 0; i < k; i++) {
            double *row = c->matrix + (size_t)(a * k + i) * size + a * k;
            for (int j = 0; j < k; j++) { /* C_n of Eq. (7) */
                double near = fmin(p->arclength[i], p->arclength[j]);
                double far = fmax(p->arclength[i], p->arclength[j]);
                row[j] += near * near * (far - near / 3.0) * (0.5 / p->numbers[RIGIDITY]);
            }
            row[i] += p->softness[i];
            c->right[a * k + i] = gap(p, i, a);
            c->low[a * k + i] = -INFINITY;
            c->high[a * k + i] = INFINITY;
        }
    double *last = c->matrix + (size_t)(size - 1) * size, pressed = 0.0;
    int first = 0; /* the tip force is on the last points only */
    while (first < n - 1 && share[first] == 0.0)
        first++;
    for (int i = 0; i < size - 1; i++) {
        double *row = c->matrix + (size_t)i * size;
        row[size - 1] = last[i] = dot(row + wide + first, share + first, n - first);
    }
    for (int i = 0; i < n; i++) {
        pressed += share[i] * last[wide + i];
        c->matrix[(size_t)(wide + i) * (size + 1)] += p->rows[SOFT * n + i];
        c->right[wide + i] = p->rows[ELASTIC * n + i];
        c->low[wide + i] = -p->rows[BOUND * n + i];
        c->high[wide + i] = p->rows[BOUND * n + i];
    }
    last[size - 1] = pressed + p->numbers[TIP_SOFTNESS];
    c->right[size - 1] = reach;
    c->low[size - 1] = 0.0;
    c->high[size - 1] = p->numbers[LIMIT];
    return 0;
}

static PyObject *bounded(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    (void)module;
    if (given != BOUNDED_ARGUMENTS) {
        PyErr_Format(PyExc_TypeError, "%d arguments, not %zd", BOUNDED_ARGUMENTS, given);
        return NULL;
    }
    Buffers all = {.count = 0};
    Problem p;
    Contact c;
    PyObject *answered = NULL, *blocks = arguments[IN_BLOCKS];
    signed char *status = NULL, *state;
    double *work = NULL;
    if (take(&p, &all, arguments) < 0)
        goto end;
    int n = p.n, wide = p.m * p.held, size = wide + n + 1;
    if (!PyTuple_Check(blocks) || PyTuple_GET_SIZE(blocks) != (p.m + 1) * (p.m + 2) / 2) {
        PyErr_SetString(PyExc_ValueError, "blocks: not one for each pair of axes");
        goto end;
    }
    if ((state = array(&all, arguments[OUT_STATUS], "b", n + 1, 1, "state")) == NULL)
        goto end;
    if ((work = PyMem_Malloc(contact_room(size) + (size_t)size)) == NULL) {
        PyErr_NoMemory();
        goto end;
    }
    lay_out(&c, size, work);
    status = (signed char *)(c.free + size);
    double reach = p.numbers[REACH];
    if (assemble(&p, reach, blocks, &all, &c) < 0)
        goto end;
    int solves = solve_contact(&c, p.status, wide, p.numbers[TOLERANCE], status);
    if (solves == 0) {
        answered = Py_NewRef(Py_None);
        goto end;
    }
    double *rows = p.rows, tip = c.x[size - 1], scale = 1e-300, loose = 0.0;
    for (int i = 0; i < size; i++) {
        scale = fmax(scale, fabs(c.right[i]));
        if (status[i] == 0)
            loose = fmax(loose, fabs(c.gradient[i]));
    }
    memcpy(p.q, c.x, (size_t)wide * sizeof(double));
    memcpy(state, status + wide, (size_t)(n + 1));
    for (int i = 0; i < n; i++) {
        rows[FRICTION * n + i] = c.x[wide + i];
        rows[AXIAL_FORCE * n + i] = c.x[wide + i] + tip * rows[SHARE * n + i];
    }
    act(&p);
    for (int i = 0; i < n; i++) {
        rows[STRAIN * n + i] = rows[SOFT * n + i] * rows[FRICTION * n + i];
        rows[SLID * n + i] = rows[ELASTIC * n + i] - dot(p.moved + i * p.d, p.axial, p.d) -
                             rows[STRAIN * n + i];
    }
    remember(&p, state);
    with_free(&p);
    double overlap = state[n] != 0 ? -c.gradient[size - 1] : 0.0;
    double back = lack(&p, tip, c.matrix[(size_t)size * size - 1], overlap);
    answered = Py_BuildValue("ddddi", tip, overlap, state[n] <= 0 ? back : 0.0, loose / scale,
                             solves);
end:
    PyMem_Free(work);
    release(&all);
    return answered;
}

static PyMethodDef methods[] = {
    {"slide", (PyCFunction)(void (*)(void))slide, METH_FASTCALL,
     "Set up a step, and solve it with every force at the bound where it was, if that holds."},
    {"bounded", (PyCFunction)(void (*)(void))bounded, METH_FASTCALL,
     "Solve in full a step that is set up."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "_balance", .m_size = -1, .m_methods = methods,
};

PyMODINIT_FUNC PyInit__balance(void)
{
    if (find_functions() < 0)
        return NULL;
    return PyModule_Create(&definition);
}
