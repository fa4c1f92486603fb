/* The algebra of a step as loops over rows and columns, a track in each lane. Matrices lie row by row.
   A sum over a row goes into eight running sums, by the number of the column modulo eight, whatever the lanes. */
#ifndef SIGMAX_KERNELS
#define SIGMAX_KERNELS
#include "lanes.h"

#define KERNEL static __attribute__((noinline, unused))
#define EIGHT(DO) DO(0) DO(1) DO(2) DO(3) DO(4) DO(5) DO(6) DO(7)
#define SUM_OF(s) (((s##0 + s##4) + (s##2 + s##6)) + ((s##1 + s##5) + (s##3 + s##7)))
/* Rows that are worked on while they lie in the nearest cache. */
#define BLOCK 4

INLINE V k_dot(const V *a, const V *row, long k) {
#define START(l) V s##l = K(0);
#define ADD(l) s##l += a[j + l] * row[j + l];
#define REST(l) if (j + l < k) { ADD(l) }
    EIGHT(START)
    long j = 0;
    for (; j + 8 <= k; j += 8) { EIGHT(ADD) }
    EIGHT(REST)
    return SUM_OF(s);
#undef ADD
}
/* a - weight row, in place, and its sum of products with the next row: one pass instead of two. */
INLINE V k_less_dot(V *a, V weight, const V *row, const V *next, long k) {
#define ADD(l) { const V left = a[j + l] - weight * row[j + l]; a[j + l] = left; s##l += left * next[j + l]; }
    EIGHT(START)
    long j = 0;
    for (; j + 8 <= k; j += 8) { EIGHT(ADD) }
    EIGHT(REST)
    return SUM_OF(s);
#undef ADD
#undef START
#undef REST
}
INLINE void k_less(V *a, V weight, const V *row, long k) {
    for (long j = 0; j < k; j++) a[j] -= weight * row[j];
}
/* The root of what is positive, else 0; and 1 / a there, else 0. */
INLINE V k_root(V a) {
    const M positive = v_less(K(0), a);
    return v_select(positive, v_sqrt(v_select(positive, a, K(1))), K(0));
}
INLINE V k_over(V a, M where) { return v_select(where, K(1) / v_select(where, a, K(1)), K(0)); }

/* What reflection p makes of row r of [[L], [0]] (m + n rows), whose product with the reflection is `along`: the number
   below its head goes to factor or cross, and what to subtract comes back. */
INLINE V k_turned(long m, long p, long r, V along, V head, V scale, const V *L, long width, V *factor, V *cross) {
    if (r >= m) {
        const V weight = along * scale;
        cross[(r - m) * m + p] = weight * head;
        return weight;
    }
    if (!width) {
        const V weight = along * scale;
        factor[r * m + p] = weight * head;
        return weight;
    }
    const V beside = L[r * width + p], weight = (along + beside * head) * scale;
    factor[r * m + p] = weight * head - beside;
    return weight;
}

/* [[L, A], [0, B]] -> [[factor, 0], [cross, rest]]: X (m + n, k) is A above B, and B becomes the rest.
   L is a triangle with rows of `width` numbers, or of width 0 its diagonal. `keep` has room for 2 m. */
KERNEL void k_absorb(long m, long n, long k, const V *L, long width, V *X, V *factor, V *cross, V *keep) {
    V *heads = keep, *scales = keep + m;
    for (long first = 0; first < m + n; first += BLOCK) {
        const long end = first + BLOCK < m + n ? first + BLOCK : m + n, before = first < m ? first : m;
        V along[BLOCK];
        for (long i = first; before && i < end; i++) along[i - first] = k_dot(X + i * k, X, k);
        for (long p = 0; p < before; p++) {
            const V *row = X + p * k;
            for (long i = first; i < end; i++) {
                V *x = X + i * k;
                const V weight = k_turned(m, p, i, along[i - first], heads[p], scales[p], L, width, factor, cross);
                if (p + 1 < before) along[i - first] = k_less_dot(x, weight, row, row + k, k);
                else k_less(x, weight, row, k);
            }
        }
        for (long p = first; p < end && p < m; p++) {
            const V *row = X + p * k, pivot = width ? L[p * width + p] : L[p];
            const V squared = pivot * pivot + k_dot(row, row, k), norm = k_root(squared);
            heads[p] = pivot + norm;
            scales[p] = k_over(norm * heads[p], v_less(K(0), squared));
            for (long above = 0; above < p; above++) factor[above * m + p] = K(0);
            factor[p * m + p] = norm;
            for (long i = p + 1; i < end; i++) {
                V *x = X + i * k;
                const V found = k_dot(x, row, k);
                k_less(x, k_turned(m, p, i, found, heads[p], scales[p], L, width, factor, cross), row, k);
            }
        }
    }
}

/* A triangle with the square of X (r, k), which is overwritten. `keep` has room for 2 r. */
KERNEL void k_tria(long r, long k, V *X, V *factor, V *keep) {
    V *scales = keep, *turns = keep + r;
    for (long first = 0; first < r; first += BLOCK) {
        const long end = first + BLOCK < r ? first + BLOCK : r;
        V along[BLOCK];
        for (long i = first; first && i < end; i++) along[i - first] = k_dot(X + i * k, X, k);
        for (long p = 0; p < first; p++) {
            const V *row = X + p * k + p;
            const long left = k - p - 1;
            for (long i = first; i < end; i++) {
                V *x = X + i * k + p;
                const V weight = along[i - first] * scales[p];
                factor[i * r + p] = turns[p] * (weight * row[0] - x[0]);
                if (p + 1 < first) along[i - first] = k_less_dot(x + 1, weight, row + 1, row + k + 1, left);
                else k_less(x + 1, weight, row + 1, left);
            }
        }
        for (long p = first; p < end; p++) {
            V *row = X + p * k + p;
            const long left = k - p;
            const V squared = k_dot(row, row, left), norm = k_root(squared), one = row[0];
            turns[p] = v_select(v_at_most(K(0), one), K(1), K(-1));
            row[0] = one + turns[p] * norm;
            scales[p] = k_over(squared + v_abs(one) * norm, v_less(K(0), squared));
            for (long above = 0; above < p; above++) factor[above * r + p] = K(0);
            factor[p * r + p] = norm;
            for (long i = p + 1; i < end; i++) {
                V *x = X + i * k + p;
                const V weight = k_dot(x, row, left) * scales[p];
                factor[i * r + p] = turns[p] * (weight * row[0] - x[0]);
                k_less(x + 1, weight, row + 1, left - 1);
            }
        }
    }
}

/* The factor of P (n, n), and whether it is sound, as a number. */
KERNEL V k_cholesky(long n, R rounding, const V *P, V *L) {
    V sum = K(0), growth = K(1);
    for (long i = 0; i < n; i++) sum += P[i * n + i];
    M sound = v_finite(sum);
    for (long j = 0; j < n; j++) {
        const V *row = L + j * n, variance = P[j * n + j];
        V pivot = variance;
        for (long l = 0; l < j; l++) pivot -= row[l] * row[l];
        sound &= v_at_most(K(-rounding) * growth * v_abs(variance), pivot);
        const M usable = v_less(K(rounding) * variance, pivot);
        const V diagonal = k_root(v_select(usable, pivot, K(0))), scale = k_over(diagonal, usable);
        growth = v_max(growth, v_select(usable, variance * scale * scale, K(1)));
        for (long i = 0; i < j; i++) L[i * n + j] = K(0);
        L[j * n + j] = diagonal;
        for (long i = j + 1; i < n; i++) {
            V *below = L + i * n, left = P[i * n + j];
            for (long l = 0; l < j; l++) left -= below[l] * row[l];
            const V most = K(4 * rounding) * growth * v_abs(variance * P[i * n + i]);
            sound &= usable | v_at_most(left * left, most);
            below[j] = left * scale;
        }
    }
    return v_number(sound);
}

/* [[L, X], [B, 0]] -> [[factor, 0], [cross, rest]], of columns X (n + p, q) that are taken away; L (n + p, n) has B below
   itself and becomes factor and cross, X the rest. Whether there is a factor, as a number. */
KERNEL V k_release(long n, long p, long q, V *L, V *X) {
    M sound = v_equal(K(0), K(0));
    for (long k = 0; k < n; k++) {
        const V *row = X + k * q, pivot = L[k * n + k], size = q > 1 ? k_root(k_dot(row, row, q)) : row[0];
        const V squared = (pivot - size) * (pivot + size), new = k_root(squared);
        const M positive = v_less(K(0), squared);
        sound &= positive | (v_equal(pivot, K(0)) & v_equal(size, K(0)));
        const V head = pivot + new, over = q > 1 ? k_over(new * head, positive) : k_over(pivot, positive);
        const V cosine = v_select(positive, new * over, K(1)), sine = size * over;
        L[k * n + k] = new;
        for (long i = 0; i < k; i++) L[i * n + k] = K(0);
        for (long i = k + 1; i < n + p; i++) {
            V *x = X + i * q;
            const V beside = L[i * n + k];
            if (q > 1) {
                const V weight = (beside * head - k_dot(x, row, q)) * over;
                L[i * n + k] = v_select(positive, weight * head - beside, beside);
                k_less(x, weight, row, q);
            } else {
                const V turned = (beside - sine * x[0]) / cosine;
                L[i * n + k] = turned;
                x[0] = cosine * x[0] - sine * turned;
            }
        }
    }
    return v_number(sound);
}

/* L^-1 b for b (m, k). */
KERNEL void k_solve_lower(long m, long k, const V *L, const V *b, V *x) {
    for (long i = 0; i < m; i++) {
        V *to = x + i * k;
        for (long c = 0; c < k; c++) to[c] = b[i * k + c];
        for (long j = 0; j < i; j++) k_less(to, L[i * m + j], x + j * k, k);
        for (long c = 0; c < k; c++) to[c] /= L[i * m + i];
    }
}

KERNEL void k_inverse_lower(long m, const V *L, V *x) {
    for (long i = 0; i < m; i++) {
        V *to = x + i * m;
        for (long c = 0; c < m; c++) to[c] = K(c == i);
        for (long j = 0; j < i; j++) k_less(to, L[i * m + j], x + j * m, j + 1);
        for (long c = 0; c <= i; c++) to[c] /= L[i * m + i];
    }
}

/* C (r, s) = A B; `ai` lies between the rows of A and `ak` between its columns, `bk` and `bj` the same of B (k, s).
   `half`: A B is symmetric, and its upper half is that below. */
KERNEL void k_product(long r, long s, long k, const V *A, long ai, long ak, const V *B, long bk, long bj, V *C, int half) {
#define TILE(DO) DO(0) DO(1) DO(2) DO(3)
    for (long i = 0; i < r; i += 4) {
        const V *a0 = A + i * ai, *a1 = i + 1 < r ? a0 + ai : a0, *a2 = i + 2 < r ? a1 + ai : a1;
        const V *a3 = i + 3 < r ? a2 + ai : a2;
        const long rows = r - i < 4 ? r - i : 4, end = half && i + 4 < s ? i + 4 : s;
        for (long j = 0; j < end; j += 2) {
            const V *b0 = B + j * bj, *b1 = j + 1 < s ? b0 + bj : b0;
#define START(x) V c##x = K(0), d##x = K(0);
#define ADD(x) { const V a = a##x[l * ak]; c##x += a * b; d##x += a * e; }
#define PUT(x) if (x < rows) { C[(i + x) * s + j] = c##x; if (j + 1 < s) C[(i + x) * s + j + 1] = d##x; }
            TILE(START)
            for (long l = 0; l < k; l++) {
                const V b = b0[l * bk], e = b1[l * bk];
                TILE(ADD)
            }
            TILE(PUT)
        }
    }
    for (long i = 0; half && i < r; i++)
        for (long j = i + 1; j < s; j++) C[i * s + j] = C[j * s + i];
#undef START
#undef ADD
#undef PUT
}

#endif
