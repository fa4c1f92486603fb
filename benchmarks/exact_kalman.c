/* A Kalman filter and fixed-interval smoother of one linear model in extended precision: square roots by reflections,
   plain loops, nothing in common with the library that it judges. Matrices have their rows one after the other. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#ifndef REAL
#define REAL long double
#define SQRT sqrtl
#endif
typedef REAL real;

/* A (r x k) turned by reflections from the right until its first `rows` are lower triangular. */
static void lower(int r, int k, int rows, real *A) {
    real v[k];
    for (int i = 0; i < rows; i++) {
        real size = 0;
        for (int c = i; c < k; c++) {
            v[c] = A[i * k + c];
            size += v[c] * v[c];
        }
        if (size == 0) continue;
        real norm = SQRT(size);
        size = 2 * (size + (v[i] < 0 ? -v[i] : v[i]) * norm);
        v[i] += v[i] < 0 ? -norm : norm;
        for (int a = i; a < r; a++) {
            real along = 0;
            for (int c = i; c < k; c++) along += A[a * k + c] * v[c];
            along *= 2 / size;
            for (int c = i; c < k; c++) A[a * k + c] -= along * v[c];
        }
    }
}

/* Lower factor of a covariance; a pivot that the rounding of the numbers given can have made is 0. */
static void root(int n, const double *P, const int *seen, real *S) {
    real A[n * n];
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) A[i * n + j] = seen && !(seen[i] && seen[j]) ? i == j : P[i * n + j];
    memset(S, 0, sizeof(real) * n * n);
    for (int j = 0; j < n; j++) {
        real pivot = A[j * n + j];
        if (!(pivot > 32 * n * 0x1p-52 * P[j * n + j]) && !(seen && !seen[j])) continue;
        for (int i = j; i < n; i++) S[i * n + j] = A[i * n + j] / SQRT(pivot);
        for (int a = j; a < n; a++)
            for (int b = j; b < n; b++) A[a * n + b] -= S[a * n + j] * S[b * n + j];
    }
}

/* C (r x k) = A (r x n) B, with B's entry [j, c] at B[j * step + c]. */
static void times(int r, int n, int k, const real *A, int along, const real *B, int step, real *C, int out) {
    for (int i = 0; i < r; i++)
        for (int c = 0; c < k; c++) {
            real sum = 0;
            for (int j = 0; j < n; j++) sum += A[i * along + j] * B[j * step + c];
            C[i * out + c] = sum;
        }
}

/* b (n x k) becomes L^-1 b for the triangle at the head of an array with rows of `width`. */
static void solve(int n, int k, const real *L, int width, real *b) {
    for (int i = 0; i < n; i++)
        for (int c = 0; c < k; c++) {
            for (int j = 0; j < i; j++) b[i * k + c] -= L[i * width + j] * b[j * k + c];
            b[i * k + c] /= L[i * width + i];
        }
}

static void copy(int r, int k, const real *from, int width, real *to) {
    for (int i = 0; i < r; i++) memcpy(to + i * k, from + i * width, sizeof(real) * k);
}

static void tell(int n, const real *x, const real *S, real *out) {
    for (int i = 0; i < n; i++) {
        real variance = 0;
        for (int j = 0; j < n; j++) variance += S[i * n + j] * S[i * n + j];
        out[i] = x[i];
        out[n + i] = SQRT(variance);
    }
}

static void widen(int size, const double *from, real *to) {
    for (int i = 0; i < size; i++) to[i] = from[i];
}

/* What a filter that keeps its mean in double precision has of it. */
static void rounded(int n, real *x) {
    for (int i = 0; i < n; i++) x[i] = (double)x[i];
}

/* out: (2, T, 2, n), filtered and smoothed means and standard deviations. Q, F are (T, n, n), H (T, m, n), R (T, m, m),
   z (T, m) with NaN where missing; with `in_double` the filtered means are rounded to double at each step. */
static void track(int n, int m, int T, const double *mean, const double *cov, const double *F, const double *Q,
           const double *H, const double *R, const double *z, int in_double, real *out) {
    int nn = n * n, w = n + m, seen[m];
    real *kept = malloc(sizeof(real) * T * (2 * n + 3 * nn));
    real x[n], S[nn], A[2 * n * 2 * n > w * w ? 4 * nn : w * w], h[m * n], nu[m], along[n * (n + 1)];
    widen(n, mean, x);
    root(n, cov, NULL, S);
    for (int t = 0; t < T; t++) {
        real *before = kept + t * (2 * n + 3 * nn), *ahead = before + n, *S0 = ahead + n, *FS = S0 + nn, *Lq = FS + nn;
        real f[nn];
        memcpy(before, x, sizeof x);
        memcpy(S0, S, sizeof S);
        widen(nn, F + t * nn, f);
        root(n, Q + t * nn, NULL, Lq);
        times(n, n, 1, f, n, before, 1, x, 1);
        if (in_double) rounded(n, x);
        memcpy(ahead, x, sizeof x);
        times(n, n, n, f, n, S0, n, FS, n);
        for (int i = 0; i < n; i++) {
            memcpy(A + 2 * i * n, FS + i * n, sizeof(real) * n);
            memcpy(A + 2 * i * n + n, Lq + i * n, sizeof(real) * n);
        }
        lower(n, 2 * n, n, A);
        copy(n, n, A, 2 * n, S);

        for (int i = 0; i < m; i++) seen[i] = !isnan(z[t * m + i]);
        real Lr[m * m];
        root(m, R + t * m * m, seen, Lr);
        widen(m * n, H + t * m * n, h);
        for (int i = 0; i < m; i++) {
            nu[i] = 0;
            for (int j = 0; j < n && !seen[i]; j++) h[i * n + j] = 0;
            if (!seen[i]) continue;
            nu[i] = z[t * m + i];
            for (int j = 0; j < n; j++) nu[i] -= h[i * n + j] * x[j];
        }
        memset(A, 0, sizeof A);
        for (int i = 0; i < m; i++) memcpy(A + i * w, Lr + i * m, sizeof(real) * m);
        times(m, n, n, h, n, S, n, A + m, w);
        for (int i = 0; i < n; i++) memcpy(A + (m + i) * w + m, S + i * n, sizeof(real) * n);
        lower(w, w, w, A);
        solve(m, 1, A, w, nu);
        for (int i = 0; i < n; i++) {
            for (int j = 0; j < m; j++) x[i] += A[(m + i) * w + j] * nu[j];
            memcpy(S + i * n, A + (m + i) * w + m, sizeof(real) * n);
        }
        if (in_double) rounded(n, x);
        tell(n, x, S, out + t * 2 * n);
    }
    real *smoothed = out + T * 2 * n;
    tell(n, x, S, smoothed + (T - 1) * 2 * n);
    for (int t = T - 1; t > 0; t--) {
        real *before = kept + t * (2 * n + 3 * nn), *ahead = before + n, *S0 = ahead + n, *FS = S0 + nn, *Lq = FS + nn;
        memset(A, 0, sizeof A);
        for (int i = 0; i < n; i++) {
            memcpy(A + 2 * i * n, FS + i * n, sizeof(real) * n);
            memcpy(A + 2 * i * n + n, Lq + i * n, sizeof(real) * n);
            memcpy(A + 2 * (n + i) * n, S0 + i * n, sizeof(real) * n);
        }
        lower(2 * n, 2 * n, n, A);
        for (int i = 0; i < n; i++) {
            along[i * (n + 1)] = x[i] - ahead[i];
            memcpy(along + i * (n + 1) + 1, S + i * n, sizeof(real) * n);
        }
        solve(n, n + 1, A, 2 * n, along);
        real left[nn], B[2 * nn];
        copy(n, n, A + 2 * nn + n, 2 * n, left);
        times(n, n, n, A + 2 * nn, 2 * n, along + 1, n + 1, B, 2 * n);
        for (int i = 0; i < n; i++) {
            x[i] = before[i];
            for (int j = 0; j < n; j++) x[i] += A[2 * nn + i * 2 * n + j] * along[j * (n + 1)];
            memcpy(B + 2 * i * n + n, left + i * n, sizeof(real) * n);
        }
        lower(n, 2 * n, n, B);
        copy(n, n, B, 2 * n, S);
        tell(n, x, S, smoothed + (t - 1) * 2 * n);
    }
    free(kept);
}

void tracks(long count, int n, int m, int T, const double *mean, const double *cov, const double *F, const double *Q,
            const double *H, const double *R, const double *z, int in_double, real *out) {
    for (long b = 0; b < count; b++)
        track(n, m, T, mean + b * n, cov + b * n * n, F + b * T * n * n, Q + b * T * n * n, H + b * T * m * n,
              R + b * T * m * m, z + b * T * m, in_double, out + b * T * 4 * n);
}
