/* What the programs share: measurements in; means and seconds out.

   program MEASUREMENTS MEANS TRACKS REPETITIONS

   Files are plain doubles, (tracks, STEPS, M) and (tracks, STEPS, N). Only the filter is timed. */
#ifndef HARNESS
#define HARNESS

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

/* Written by yardsticks.py: N, M, STEPS, DT, and arrays MEAN, ROOT_PRIOR, ROOT_Q, ROOT_R. */
#include "scenario.h"

/* Each program's own. */
static void filter(const double *z, double *mean, long tracks);

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int ascending(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static void need(int fine, const char *what) {
    if (fine) return;
    perror(what);
    exit(1);
}

static double *numbers(size_t count) {
    double *made = (double *)malloc(count * sizeof(double));
    need(made != NULL, "memory");
    return made;
}

int main(int argc, char **argv) {
    if (argc != 5) {
        fprintf(stderr, "%s MEASUREMENTS MEANS TRACKS REPETITIONS\n", argv[0]);
        return 2;
    }
    const long tracks = atol(argv[3]), repetitions = atol(argv[4]);
    const size_t given = (size_t)tracks * STEPS * M, made = (size_t)tracks * STEPS * N;
    double *z = numbers(given), *mean = numbers(made), *seconds = numbers((size_t)repetitions);
    FILE *file = fopen(argv[1], "rb");
    need(file && fread(z, sizeof(double), given, file) == given, argv[1]);
    fclose(file);
    for (long k = 0; k < repetitions; k++) {
        const double start = now();
        filter(z, mean, tracks);
        seconds[k] = now() - start;
    }
    qsort(seconds, (size_t)repetitions, sizeof(double), ascending);
    const double median = (seconds[(repetitions - 1) / 2] + seconds[repetitions / 2]) / 2;
    printf("{\"best\": %.9g, \"median\": %.9g}\n", seconds[0], median);
    file = fopen(argv[2], "wb");
    need(file && fwrite(mean, sizeof(double), made, file) == made && fclose(file) == 0, argv[2]);
    return 0;
}

#endif
