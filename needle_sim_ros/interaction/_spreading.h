/* SPDX-License-Identifier: Apache-2.0 */
/* How lengths and the tip force are shared out over the track points, as in spreading.py, and how
 * softly the needle holds those near its tip, as in Balance._softness. */
#ifndef NEEDLE_SIM_SPREADING_H
#define NEEDLE_SIM_SPREADING_H
#include <math.h>
#include <string.h>

#define LEAST 1e-6 /* as in spreading.py */

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
        softness[last] = (bevel / behind + behind / bevel - 2.0) / (grip * spacing);
}

#endif
