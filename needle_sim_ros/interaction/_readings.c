/* SPDX-License-Identifier: Apache-2.0 */
/* What the forces along a needle do to it; readings.py says what is read. */
#include "../_buffers.h"

#define MOST_AXES 3
#define ARGUMENTS 12

/* Sums over the forces on the tissue. */
typedef struct {
    double moments[MOST_AXES][4]; /* of q, q s, q s^2 and q s^3 along each lateral axis */
    double rubbing[MOST_AXES];    /* friction times deflection, of the held points */
    double friction, beyond;      /* axial, and that of it ahead of the tip */
    double twist;
} Sums;

typedef struct {
    double deflection[3], slope[3], position[3], force[3], torque[3], friction;
} Readings;

static int work_out(Buffers *all, PyObject *const *arguments, Readings *out)
{
    double *s, *q, *f, *softness, *points, *moved, *lateral, origin[MOST_AXES], axial[MOST_AXES];
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
    if (brief(arguments[7], d, origin) < 0 || brief(arguments[8], d, axial) < 0)
        return -1;
    TAKE_NUMBER(tip, 9)
    TAKE_NUMBER(length, 10)
    TAKE_NUMBER(rigidity, 11)

    Sums sums = {0};
    for (int k = 0; k < held; k++) {
        double bent[MOST_AXES];
        for (int a = 0; a < m; a++) {
            double force = q[a * held + k], *powers = sums.moments[a];
            powers[0] += force;
            powers[1] += force * s[k];
            powers[2] += force * (s[k] * s[k]);
            powers[3] += force * (s[k] * s[k] * s[k]);
            bent[a] = softness[k] * force;
            for (int i = 0; i < d; i++)
                bent[a] += lateral[a * d + i] * (points[k * d + i] + moved[k * d + i] - origin[i]);
            if (k < active)
                sums.rubbing[a] += bent[a] * f[k];
        }
        if (m == 2)
            sums.twist += bent[1] * q[k] - bent[0] * q[held + k];
    }
    for (int k = 0; k < active; k++)
        *(k < held ? &sums.friction : &sums.beyond) += f[k];
    sums.friction += sums.beyond;

    /* all forces act between clamp and tip: a = s_k, b = L in the flexibility */
    double bent[MOST_AXES], moment[MOST_AXES], place[MOST_AXES];
    for (int i = 0; i < d; i++)
        place[i] = origin[i] + axial[i] * length;
    *out = (Readings){.friction = sums.friction};
    for (int a = 0; a < m; a++) {
        const double *powers = sums.moments[a];
        bent[a] = -(3.0 * length * powers[2] - powers[3]) / (6.0 * rigidity);
        out->slope[a] = -powers[2] / (2.0 * rigidity);
        out->deflection[a] = bent[a];
        out->force[a] = -powers[0];
        moment[a] = sums.rubbing[a] - powers[1] + bent[a] * (sums.beyond + tip);
        for (int i = 0; i < d; i++)
            place[i] += lateral[a * d + i] * bent[a];
    }
    out->force[2] = -(sums.friction + tip);
    out->position[0] = place[0];
    out->position[1] = d == 3 ? place[1] : 0.0;
    out->position[2] = place[d - 1];
    out->torque[0] = m == 2 ? -moment[1] : 0.0;
    out->torque[1] = moment[0];
    out->torque[2] = sums.twist;
    return 0;
}

static PyObject *readings(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    (void)module;
    Buffers all = {.count = 0};
    Readings r;
    if (given != ARGUMENTS)
        return PyErr_Format(PyExc_TypeError, "%d arguments, not %zd", ARGUMENTS, given);
    int failed = work_out(&all, arguments, &r) < 0;
    release(&all);
    if (failed)
        return NULL;
    return Py_BuildValue("(ddd)(dd)(ddd)(ddd)(ddd)d", r.deflection[0], r.deflection[1],
                         r.deflection[2], r.slope[0], r.slope[1], r.position[0], r.position[1],
                         r.position[2], r.force[0], r.force[1], r.force[2], r.torque[0],
                         r.torque[1], r.torque[2], r.friction);
}

static PyMethodDef methods[] = {
    {"readings", (PyCFunction)(void (*)(void))readings, METH_FASTCALL,
     "Return what the forces along a needle do to it."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "_readings", .m_size = -1, .m_methods = methods,
};

PyMODINIT_FUNC PyInit__readings(void)
{
    return PyModule_Create(&definition);
}
