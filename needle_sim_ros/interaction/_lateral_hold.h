/* SPDX-License-Identifier: Apache-2.0 */
/* Lateral forces by a factor of before, as in lateral_hold.py. */
#ifndef NEEDLE_SIM_LATERAL_HOLD_H
#define NEEDLE_SIM_LATERAL_HOLD_H
#include "../_linear_algebra.h"

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

#endif
