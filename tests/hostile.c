/* Gives a filter numbers that nobody should send, and checks that it keeps its promises: a step that cannot be made
   leaves the state as it was, one that is made leaves finite numbers. Built for each filter by test_export.py. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "hostile.h"

static uint64_t seed = 88172645463325252u;

static double uniform(void) {
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (double)(seed >> 11) / 9007199254740992.0;
}

static double any(double scale, double often) {
    static const double odd[] = {NAN, INFINITY, -INFINITY, 1e308, -1e308, 5e-324, -5e-324, 1e-310, 0.0, -0.0, 1e18, -1.0};
    if (uniform() < often) return odd[(int)(uniform() * 12)];
    return scale * (2 * uniform() - 1);
}

static int finite_all(const double *x, int size) {
    int i;
    for (i = 0; i < size; i++)
        if (!isfinite(x[i])) return 0;
    return 1;
}

int main(int count, char **arguments) {
    long sequences = count > 1 ? strtol(arguments[1], NULL, 10) : 1000, k, made = 0, refused = 0;
    for (k = 0; k < sequences; k++) {
        STATE state, before;
        TOLD told;
        double mean[SIZE], cov[SIZE * SIZE], z[MEASURED];
        double often = k % 4 ? 0.02 : 0.4;
        int i, j, t, fault;
        for (i = 0; i < SIZE; i++) mean[i] = prior_mean[i] + any(sqrt(prior_cov[i * SIZE + i]), often / 4);
        for (i = 0; i < SIZE * SIZE; i++) cov[i] = prior_cov[i];
        for (i = 0; i < SIZE; i++)
            for (j = 0; j <= i; j++)
                if (uniform() < often / 8) cov[i * SIZE + j] = cov[j * SIZE + i] = any(1, 1);
        memset(&state, 0, sizeof state);
        if (START(&state, mean, cov) > 0) {
            refused++;
            continue;
        }
        for (t = 0; t < 8; t++) {
            before = state;
            fault = PREDICT(&state, any(0.5, often) + 1);
            if (fault <= 0) {
                made++;
            } else {
                refused++;
                if (memcmp(&before, &state, sizeof state)) return 3;
            }
            if (fault <= 0 && !finite_all(state.mean, SIZE)) return 4;
            before = state;
            for (i = 0; i < MEASURED; i++) z[i] = measured[i] + any(1, often);
            fault = UPDATE(&state, z, t % 2 ? &told : NULL);
            if (fault <= 0) {
                made++;
            } else {
                refused++;
                if (memcmp(&before, &state, sizeof state)) return 5;
            }
            if (fault <= 0 && !finite_all(state.mean, SIZE)) return 6;
        }
    }
    printf("%ld made, %ld refused\n", made, refused);
    return !(made > sequences && refused > sequences / 10);
}
