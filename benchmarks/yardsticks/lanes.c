/* SRCKFB by hand: one track in each lane of a vector, every array with the lane as its last axis, so that the
   compiler needs no more than loops over lanes to fill its registers.

   gcc -Ofast -march=native -fopenmp-simd [-DUNROLL] lanes.c -lm

   Nothing is checked, no likelihood is computed, and no measurement can be missing: what a program for one task
   does without. */
#include <math.h>

#include "harness.h"

#define LANES 8
#define POINTS (2 * N)
#define EACH _Pragma("omp simd") for (int l = 0; l < LANES; l++)
#ifdef UNROLL /* Long code, with much of the arrays in registers: what GCC does not dare by itself. */
#define LOOP(i, from, end) _Pragma("GCC unroll 16") for (int i = from; i < end; i++)
#else
#define LOOP(i, from, end) for (int i = from; i < end; i++)
#endif
#define INLINE static inline __attribute__((always_inline))

enum { NORTH, EAST, SPEED, COURSE, RATE };
enum { RANGE, AZIMUTH, DOPPLER };

typedef double V[LANES] __attribute__((aligned(64)));

INLINE double wrapped(double angle) { return angle - 2 * M_PI * rint(angle * (0.5 / M_PI)); }

/* Sine and cosine of one angle stand in loops of their own: together they would become a call of sincos, of which
   there is no vector version. */
INLINE void motion(const V x[N], V y[N]) {
    V way, middle;
    EACH {
        const double half = x[RATE][l] * (DT / 2), square = half * half;
        const double ratio = square < 1e-6 ? 1 - square / 6 * (1 - square / 20) : sin(half) / half;
        way[l] = x[SPEED][l] * DT * ratio;
        middle[l] = x[COURSE][l] + half;
    }
    EACH y[NORTH][l] = x[NORTH][l] + way[l] * cos(middle[l]);
    EACH y[EAST][l] = x[EAST][l] + way[l] * sin(middle[l]);
    EACH {
        y[SPEED][l] = x[SPEED][l];
        y[COURSE][l] = x[COURSE][l] + x[RATE][l] * DT;
        y[RATE][l] = x[RATE][l];
    }
}

INLINE void sensor(const V x[N], V y[M]) {
    EACH y[AZIMUTH][l] = atan2(x[EAST][l], x[NORTH][l]);
    EACH {
        y[RANGE][l] = sqrt(x[NORTH][l] * x[NORTH][l] + x[EAST][l] * x[EAST][l]);
        y[DOPPLER][l] = x[SPEED][l] * cos(x[COURSE][l] - y[AZIMUTH][l]);
    }
}

/* a becomes [L, 0] with L a lower triangle and the same a aᵀ; the zeros are not written. */
INLINE void tria(int rows, int columns, V a[rows][columns]) {
    LOOP(k, 0, rows) {
        V squared, norm, scale;
        EACH squared[l] = 0;
        LOOP(j, k, columns) EACH squared[l] += a[k][j][l] * a[k][j][l];
        EACH {
            const double first = a[k][k][l];
            norm[l] = copysign(sqrt(squared[l]), first);
            /* The row is its own mirror but for its first entry, which stays there until all is reflected. */
            a[k][k][l] = first + norm[l];
            scale[l] = 1 / (squared[l] + first * norm[l]);
        }
        LOOP(i, k + 1, rows) {
            V weight;
            EACH weight[l] = 0;
            LOOP(j, k, columns) EACH weight[l] += a[k][j][l] * a[i][j][l];
            EACH weight[l] *= scale[l];
            LOOP(j, k, columns) EACH a[i][j][l] -= weight[l] * a[k][j][l];
        }
        EACH a[k][k][l] = -norm[l];
    }
}

/* The points x ± √N S e_j; column j of a lower triangle begins in row j. */
INLINE void points(const V x[N], V s[N][N], V at[POINTS][N]) {
    const double reach = sqrt(N);
    LOOP(j, 0, N)
    LOOP(i, 0, N) EACH {
        const double away = i < j ? 0 : reach * s[i][j][l];
        at[j][i][l] = x[i][l] + away;
        at[N + j][i][l] = x[i][l] - away;
    }
}

/* Values of one component at all points -> their mean, and in place what they differ from it. An angle is counted
   from the first of them, since neither lies more than half a turn away. */
INLINE void centre(int size, V y[POINTS][size], int i, int angle, V mean) {
    V first, sum;
    EACH first[l] = angle ? y[0][i][l] : 0;
    EACH sum[l] = 0;
    LOOP(j, 0, POINTS) EACH {
        y[j][i][l] = angle ? wrapped(y[j][i][l] - first[l]) : y[j][i][l];
        sum[l] += y[j][i][l];
    }
    EACH sum[l] *= 1.0 / POINTS;
    LOOP(j, 0, POINTS) EACH y[j][i][l] -= sum[l];
    EACH mean[l] = angle ? wrapped(first[l] + sum[l]) : sum[l];
}

INLINE void predict(V x[N], V s[N][N]) {
    V at[POINTS][N], y[POINTS][N], a[N][POINTS + N];
    points(x, s, at);
    LOOP(j, 0, POINTS) motion(at[j], y[j]);
    const double root = sqrt(1.0 / POINTS);
    LOOP(i, 0, N) {
        centre(N, y, i, i == COURSE, x[i]);
        LOOP(j, 0, POINTS) EACH a[i][j][l] = y[j][i][l] * root;
        LOOP(j, 0, N) EACH a[i][POINTS + j][l] = i == j ? ROOT_Q[i] : 0;
    }
    tria(N, POINTS + N, a);
    LOOP(i, 0, N)
    LOOP(j, 0, i + 1) EACH s[i][j][l] = a[i][j][l];
}

/* Half the difference of a pair of points is what a straight line explains (E), half their sum what it misses: that
   goes to the noise first, so that the block array [[R, E], [0, S]] has one column for each component and no more. */
INLINE void correct(V x[N], V s[N][N], const V z[M]) {
    V at[POINTS][N], y[POINTS][M], expected[M], noise[M][M + N], a[M + N][M + N], nu[M];
    points(x, s, at);
    LOOP(j, 0, POINTS) sensor(at[j], y[j]);
    const double root = sqrt(0.5 / POINTS);
    LOOP(i, 0, M) {
        centre(M, y, i, i == AZIMUTH, expected[i]);
        LOOP(j, 0, M) EACH noise[i][j][l] = i == j ? ROOT_R[i] : 0;
        LOOP(j, 0, N) EACH {
            noise[i][M + j][l] = (y[j][i][l] + y[N + j][i][l]) * root;
            a[i][M + j][l] = (y[j][i][l] - y[N + j][i][l]) * root;
        }
    }
    tria(M, M + N, noise);
    LOOP(i, 0, M)
    LOOP(j, 0, M) EACH a[i][j][l] = j <= i ? noise[i][j][l] : 0;
    LOOP(i, 0, N) {
        LOOP(j, 0, M) EACH a[M + i][j][l] = 0;
        LOOP(j, 0, N) EACH a[M + i][M + j][l] = j <= i ? s[i][j][l] : 0;
    }
    tria(M + N, M + N, a);
    LOOP(i, 0, M) {
        EACH nu[i][l] = i == AZIMUTH ? wrapped(z[i][l] - expected[i][l]) : z[i][l] - expected[i][l];
        LOOP(j, 0, i) EACH nu[i][l] -= a[i][j][l] * nu[j][l];
        EACH nu[i][l] /= a[i][i][l];
    }
    LOOP(i, 0, N) {
        LOOP(j, 0, M) EACH x[i][l] += a[M + i][j][l] * nu[j][l];
        LOOP(j, 0, i + 1) EACH s[i][j][l] = a[M + i][M + j][l];
    }
    EACH x[COURSE][l] = wrapped(x[COURSE][l]);
}

static void filter(const double *z, double *mean, long tracks) {
    for (long first = 0; first < tracks; first += LANES) {
        const int count = tracks - first < LANES ? (int)(tracks - first) : LANES;
        V x[N], s[N][N], measured[M];
        LOOP(i, 0, N) {
            EACH x[i][l] = MEAN[i];
            LOOP(j, 0, N) EACH s[i][j][l] = i == j ? ROOT_PRIOR[i] : 0;
        }
        for (int t = 0; t < STEPS; t++) {
            for (int l = 0; l < LANES; l++) { /* Lanes without a track repeat the first. */
                const double *from = z + ((first + (l < count ? l : 0)) * STEPS + t) * M;
                LOOP(i, 0, M) measured[i][l] = from[i];
            }
            predict(x, s);
            correct(x, s, measured);
            for (int l = 0; l < count; l++)
                LOOP(i, 0, N) mean[((first + l) * STEPS + t) * N + i] = x[i][l];
        }
    }
}
