/* SPDX-License-Identifier: Apache-2.0 */
/* The contact problem by exchanges and projected Newton, as in contact_solve.py. */
#ifndef NEEDLE_SIM_CONTACT_SOLVE_H
#define NEEDLE_SIM_CONTACT_SOLVE_H
#include "../_linear_algebra.h"
#include <math.h>

/* as in contact_solve.py */
#define PATIENCE 10
#define FEW_CHANCES 2
#define BESIDE 1e-12

/* The contact problem: min 1/2 x'Ax - b'x with low <= x <= high. */
typedef struct {
    double *matrix, *right, *low, *high, *x, *gradient, *block, *target, *change, *pulled;
    int *free;
    int size;
} Contact;

static size_t contact_room(int size)
{
    return (size_t)size * ((size_t)(2 * size + 8) * sizeof(double) + sizeof(int));
}

static void lay_out(Contact *c, int size, double *work)
{
    c->size = size;
    c->matrix = work;
    c->block = c->matrix + (size_t)size * size;
    c->right = c->block + (size_t)size * size;
    c->low = c->right + size;
    c->high = c->low + size;
    c->x = c->high + size;
    c->gradient = c->x + size;
    c->target = c->gradient + size;
    c->change = c->target + size;
    c->pulled = c->change + size;
    c->free = (int *)(c->pulled + size);
}

/* Set `target` to the minimum over the free unknowns, the others held where they are. */
static int newton(Contact *c, int count)
{
    int size = c->size, one = 1, info = 0;
    memcpy(c->target, c->x, (size_t)size * sizeof(double));
    for (int i = 0; i < count; i++)
        c->target[c->free[i]] = 0.0;
    if (count == 0)
        return 0;
    if (count < size)
        product(c->matrix, size, size, size, c->target, c->pulled);
    for (int i = 0; i < count; i++) {
        const double *row = c->matrix + (size_t)c->free[i] * size;
        double *to = c->block + (size_t)i * count;
        for (int j = 0; j <= i; j++)
            to[j] = row[c->free[j]];
        c->change[i] = c->right[c->free[i]] - (count < size ? c->pulled[c->free[i]] : 0.0);
    }
    /* row-major lower is column-major upper */
    potrf("U", &count, c->block, &count, &info);
    if (info != 0)
        return -1;
    potrs("U", &count, &one, c->block, &count, c->change, &count, &info);
    for (int i = 0; i < count; i++)
        c->target[c->free[i]] = c->change[i];
    return 0;
}

static double clipped(double value, double low, double high)
{
    return fmin(fmax(value, low), high);
}

/* contact_solve._armijo: shorten the projected step until the objective falls. */
static void armijo(Contact *c, int count)
{
    int size = c->size;
    double slope = 0.0, step = 1.0, *trial = c->block, *moved = c->change, *pulled = c->pulled;
    for (int i = 0; i < count; i++)
        slope += c->gradient[c->free[i]] * (c->target[c->free[i]] - c->x[c->free[i]]);
    for (;;) {
        for (int i = 0; i < size; i++) {
            trial[i] = clipped(c->x[i] + step * (c->target[i] - c->x[i]), c->low[i], c->high[i]);
            moved[i] = trial[i] - c->x[i];
        }
        product(c->matrix, size, size, size, moved, pulled);
        double fall = dot(c->gradient, moved, size) + 0.5 * dot(moved, pulled, size);
        if (fall <= 1e-4 * step * slope || step < 1e-10)
            break;
        step *= 0.5;
    }
    for (int i = 0; i < size; i++) {
        c->x[i] = trial[i];
        c->gradient[i] += pulled[i];
    }
}

/* Set `gradient` to that where `x` is. */
static void incline(Contact *c)
{
    product(c->matrix, c->size, c->size, c->size, c->x, c->gradient);
    for (int i = 0; i < c->size; i++)
        c->gradient[i] -= c->right[i];
}

/* Put what is at a bound there, and list the rest; returns how many these are. */
static int hold(Contact *c, const signed char *status)
{
    int count = 0;
    for (int i = 0; i < c->size; i++) {
        c->x[i] = status[i] < 0 ? c->low[i] : status[i] > 0 ? c->high[i] : 0.0;
        if (status[i] == 0)
            c->free[count++] = i;
    }
    return count;
}

/* contact_solve._exchanged, from `status`: how many systems it took, negative where it does not
 * get there, 0 where there is no solution. */
static int exchange(Contact *c, double allowed, signed char *status)
{
    int fewest = c->size + 1, chances = FEW_CHANCES;
    for (int i = 0; i < c->size; i++)
        if (c->low[i] == c->high[i])
            status[i] = -1;
    for (int iteration = 1;; iteration++) {
        int wrong = 0;
        double worst = 0.0;
        if (newton(c, hold(c, status)) < 0)
            return 0;
        for (int i = 0; i < c->size; i++) {
            double nearest = clipped(c->target[i], c->low[i], c->high[i]);
            int beside = fabs(c->target[i] - nearest) <= BESIDE * fabs(nearest);
            c->x[i] = beside ? nearest : c->target[i];
        }
        incline(c);
        for (int i = 0; i < c->size; i++) {
            int before = status[i];
            if (before == 0) {
                worst = fmax(worst, fabs(c->gradient[i]));
                status[i] = c->x[i] < c->low[i] ? -1 : c->x[i] > c->high[i];
            } else if (before * c->gradient[i] > allowed && c->low[i] < c->high[i])
                status[i] = 0;
            wrong += status[i] != before;
        }
        if (wrong == 0 && worst <= allowed) {
            for (int i = 0; i < c->size; i++) /* what nothing presses counts as free */
                if (fabs(c->gradient[i]) <= allowed && c->low[i] < c->high[i])
                    status[i] = 0;
            return iteration;
        }
        chances -= wrong >= fewest;
        if (wrong == 0 || chances < 0)
            return -iteration;
        fewest = wrong < fewest ? wrong : fewest;
    }
}

/* contact_solve.solve_contact; returns how often it solved, 0 where it does not get there. The
 * first `sure` unknowns have no bounds. */
static int solve_contact(Contact *c, const signed char *guess, int sure, double tolerance,
                         signed char *status)
{
    int size = c->size;
    double scale = 1e-300;
    for (int i = 0; i < size; i++)
        scale = fmax(scale, fabs(c->right[i]));
    double allowed = tolerance * scale;
    memset(status, 0, (size_t)sure);
    memcpy(status + sure, guess, (size_t)(size - sure));
    int spent = exchange(c, allowed, status);
    if (spent >= 0)
        return spent;
    memcpy(status + sure, guess, (size_t)(size - sure));
    if (newton(c, hold(c, status)) < 0)
        return 0;
    for (int i = 0; i < size; i++)
        c->x[i] = clipped(c->target[i], c->low[i], c->high[i]);
    incline(c);
    for (int iteration = 1; iteration <= PATIENCE; iteration++) {
        double worst = 0.0;
        int count = 0;
        for (int i = 0; i < size; i++) {
            int low = c->x[i] <= c->low[i], high = c->x[i] >= c->high[i];
            int pressed = (low && c->gradient[i] > 0) || (high && c->gradient[i] < 0);
            status[i] = !pressed ? 0 : low ? -1 : 1;
            if (!pressed) {
                c->free[count++] = i;
                worst = fmax(worst, fabs(c->gradient[i]));
            }
        }
        if (worst <= allowed)
            return iteration - spent;
        if (newton(c, count) < 0)
            return 0;
        armijo(c, count);
    }
    return 0;
}

#endif
