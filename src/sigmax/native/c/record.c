/* Runs lowered steps over records: one track in each lane, time in a loop, arrays in the caller's layout
   (track first). The functions `predict`, `correct` and `back` are lowered ones. */
#include "lanes.h"

#include <pthread.h>
#include <stdlib.h>

/* Room for so many numbers of each lane: one block a thread, which lasts as long as the thread and is used again. */
static pthread_key_t block_of_thread;
static pthread_once_t once = PTHREAD_ONCE_INIT;
static void begin(void) { pthread_key_create(&block_of_thread, free); }
static V *room(long count) {
    const size_t head = 64, size = (size_t)count * sizeof(V);
    pthread_once(&once, begin);
    void *block = pthread_getspecific(block_of_thread);
    if (!block || *(size_t *)block < size) {
        free(block);
        if (posix_memalign(&block, head, head + size)) abort();
        *(size_t *)block = size;
        pthread_setspecific(block_of_thread, block);
    }
    return (V *)((char *)block + head);
}

typedef void (*Step)(const R *c, V *w, const V *state, const V *given, V *next, V *told);
typedef void (*Back)(const R *c, V *w, const V *state, const V *later, const V *given, V *next, V *told);

/* An array whose element for a track and step lies at data[track * per_track + step * per_step]. */
typedef struct {
    const R *data;
    long size, per_track, per_step;
} Series;

/* What `correct` tells, in this order; after it the residual and the rows of the innovation's factor. */
enum { NIS, LOG_LIKELIHOOD, DOF, FAULT, RESIDUAL };

typedef struct {
    Step correct;
    const R *c;
    Series z;
    long dim; /* deviations of what it measures */
    R *residual, *factor;
} Sensor;

/* A whole step at a factor and an interval that stay the same, which `setup` is told behind the model's numbers. */
typedef struct {
    Step step; /* (c, mean, z, next mean, told) */
    void (*setup)(const R *parameters, R *c);
    const R *numbers;
    long count, constants; /* how many numbers, and what follows from them and from the factor */
} Settled;

/* What it tells: SOUND where each choice is that of the step it was made from; the residual after it. */
enum { SETTLED_NIS, SETTLED_LIKELIHOOD, SOUND, SETTLED_RESIDUAL };

typedef struct {
    long tracks, steps, points, n, size; /* numbers of the mean, rows of the factor, numbers of a row */
    Step predict; /* absent: no time passes */
    const R *c;
    Series dt, u;
    long sensors;
    const Sensor *sensor;
    R *state; /* (tracks, size), in and out: mean, lower factor row by row, and what stands behind them */
    /* Out, each of them possibly absent. */
    R *total, *mean, *factor, *nis, *log_likelihood;
    signed char *fault;
    long long *dof;
    R *rest; /* what stands behind mean and factor in a row */
    long moving_from; /* the first step that is predicted: 1 where the state given is that of the first */
    long workspace;   /* numbers of each lane that the steps need room for */
    const Settled *settled; /* of the one sensor; absent where the factor depends on what is measured */
} Record;

/* The elements of the tracks from `first` on, a lane each; behind the last track its elements are repeated. */
static void gather(const Series *s, long first, long last, long step, V *to) {
    const R *from = s->data + first * s->per_track + step * s->per_step;
    if (s->per_track == 0 || last - first == 1) {
        for (long i = 0; i < s->size; i++) to[i] = K(from[i]);
        return;
    }
    const R *row[W];
    for (long lane = 0; lane < W; lane++) row[lane] = from + (lane < last - first ? lane : last - first - 1) * s->per_track;
    for (long i = 0; i < s->size; i++) {
        V all = {0};
#pragma GCC unroll 16
        for (int lane = 0; lane < W; lane++) all[lane] = row[lane][i]; /* in a register: no stores are waited for */
        to[i] = all;
    }
}

static void put(const V *from, long size, int lane, R *to) {
    for (long i = 0; i < size; i++) to[i] = from[i][lane];
}

/* Lower triangle row by row -> all rows. */
static void put_factor(const V *from, long n, int lane, R *to) {
    for (long i = 0; i < n; i++)
        for (long j = 0; j < n; j++) to[i * n + j] = j <= i ? (*from++)[lane] : 0;
}

/* Where a record stands after step t, for each of its lanes. */
static void put_step(const Record *r, long first, int lanes, long t, const V *now, V nis, V likelihood, V fault, V dof) {
    const long head = r->points + r->n * (r->n + 1) / 2;
    for (int lane = 0; lane < lanes; lane++) {
        const long at = (first + lane) * r->steps + t;
        if (r->mean) put(now, r->points, lane, r->mean + at * r->points);
        if (r->factor) put_factor(now + r->points, r->n, lane, r->factor + at * r->n * r->n);
        if (r->rest) put(now + head, r->size - head, lane, r->rest + at * (r->size - head));
        if (r->fault) r->fault[at] = (signed char)fault[lane];
        if (r->nis) r->nis[at] = nis[lane];
        if (r->dof) r->dof[at] = (long long)dof[lane];
        if (r->log_likelihood) r->log_likelihood[at] = likelihood[lane];
    }
}

static void put_innovation(const Record *r, long first, int lanes, long t, long s, const V *residual, const V *factor) {
    const Sensor *sensor = r->sensor + s;
    const long dim = sensor->dim;
    for (int lane = 0; lane < lanes; lane++) {
        const long at = (first + lane) * r->steps + t;
        if (sensor->residual) put(residual, dim, lane, sensor->residual + at * dim);
        if (sensor->factor) put(factor, dim * dim, lane, sensor->factor + at * dim * dim);
    }
}

/* Rounding of a factor, in parts of its row: what the last bits of a recursion wander by. */
#define WANDERING (sizeof(R) == 8 ? 0x1p-50 : 0x1p-21)

/* Whether a factor is the same in all lanes, and in each row what it was, but for rounding. */
static int unchanged(const V *factor, const V *before, long n) {
    for (long i = 0; i < n; factor += ++i, before += i) {
        R scale = 0;
        for (long j = 0; j <= i; j++) scale += factor[j][0] < 0 ? -factor[j][0] : factor[j][0];
        for (long j = 0; j <= i; j++)
            if (v_any(v_unequal(factor[j], K(factor[j][0]))) ||
                v_any(v_less(K((R)WANDERING * scale), v_abs(factor[j] - before[j]))))
                return 0;
    }
    return 1;
}

/* Whether steps have settled. One that converges changes as much from the 2^k-th to the 2^(k+1)-th regular step as it
   ever will again, but for the square of what it has changed by in parts of all: so it is looked at then alone. */
typedef struct {
    long regular; /* steps in a row of the same interval, with nothing missing */
    int settled;
    R dt;
} Settling;

/* Tracks [first, end). Steps of sensors that nobody heard from cost nothing. */
void record(const Record *r, long first, long end) {
    const long head = r->points + r->n * (r->n + 1) / 2;
    long widest = 1;
    for (long s = 0; s < r->sensors; s++)
        if (r->sensor[s].z.size > widest) widest = r->sensor[s].z.size;
    const Settled *steady = r->settled;
    const long wide = steady ? head - r->points : 1, dims = steady ? r->sensor->dim : 1;
    const long inputs = 1 + widest + r->u.size, said = RESIDUAL + widest * (widest + 1);
    V *const buffers = room(2 * r->size + inputs + said + wide + dims * dims + r->workspace);
    V *const given = buffers + 2 * r->size, *const told = given + inputs, *const before = told + said;
    V *const innovation = before + wide, *const w = innovation + dims * dims;
    R numbers[steady ? steady->count + wide + 1 : 1], c[steady ? steady->constants : 1];
    const V missing = K(__builtin_nan(""));
    for (; first < end; first += W) {
        const int lanes = first + W <= end ? W : (int)(end - first);
        V *now = buffers, *next = buffers + r->size, total = K(0);
        const Series start = {r->state, r->size, r->size, 0};
        gather(&start, first, end, 0, now);
        Settling state = {0, 0, 0};
        for (long t = 0; t < r->steps; t++) {
            V dt = K(0);
            if (state.settled) {
                gather(&r->dt, first, end, t, &dt);
                gather(&r->sensor->z, first, end, t, given);
                steady->step(c, w, now, given, next, told);
                if (!v_any(v_unequal(dt, K(state.dt))) && !v_any(v_equal(told[SOUND], K(0)))) {
                    for (long i = 0; i < r->points; i++) now[i] = next[i];
                    total += told[SETTLED_LIKELIHOOD];
                    put_innovation(r, first, lanes, t, 0, told + SETTLED_RESIDUAL, innovation);
                    put_step(r, first, lanes, t, now, told[SETTLED_NIS], told[SETTLED_LIKELIHOOD], K(0), K((R)dims));
                    continue;
                }
                state.settled = 0, state.regular = 0;
            }
            V fault = K(0), nis = K(0), dof = K(0), likelihood = K(0), *swapped;
            if (r->predict && t >= r->moving_from) {
                gather(&r->dt, first, end, t, given);
                gather(&r->u, first, end, t, given + 1);
                dt = given[0];
                r->predict(r->c, w, now, given, next, told);
                fault = told[0];
                swapped = now, now = next, next = swapped;
            }
            for (long s = 0; s < r->sensors; s++) {
                const Sensor *sensor = r->sensor + s;
                const long m = sensor->z.size, dim = sensor->dim;
                M heard = v_unequal(K(0), K(0));
                gather(&sensor->z, first, end, t, given);
                for (long i = 0; i < m; i++) {
                    given[i] = v_select(v_at_most(fault, K(0)), given[i], missing);
                    heard |= v_equal(given[i], given[i]);
                }
                if (v_any(heard)) {
                    gather(&r->u, first, end, t, given + m);
                    sensor->correct(sensor->c, w, now, given, next, told);
                    swapped = now, now = next, next = swapped;
                    nis += v_select(v_less(K(0), told[DOF]), told[NIS], K(0));
                    dof += told[DOF];
                    likelihood += told[LOG_LIKELIHOOD];
                    fault = v_select(v_at_most(fault, K(0)) & v_unequal(told[FAULT], K(0)), told[FAULT], fault);
                } else {
                    for (long i = 0; i < dim; i++) told[RESIDUAL + i] = missing;
                    for (long i = 0; i < dim * dim; i++) told[RESIDUAL + dim + i] = K(0);
                }
                put_innovation(r, first, lanes, t, s, told + RESIDUAL, told + RESIDUAL + dim);
            }
            total += likelihood;
            nis = v_select(v_less(K(0), dof), nis, missing);
            put_step(r, first, lanes, t, now, nis, likelihood, fault, dof);
            if (!steady || !r->predict || t < r->moving_from) continue;
            if (v_any(v_unequal(dt, K(state.dt))) || v_any(v_unequal(fault, K(0))) || v_any(v_unequal(dof, K((R)dims))))
                state = (Settling){0, 0, dt[0]};
            else if (++state.regular >= 8 && (state.regular & (state.regular - 1)) == 0) {
                const V *factor = now + r->points;
                if (state.regular > 8 && unchanged(factor, before, r->n)) {
                    for (long i = 0; i < steady->count; i++) numbers[i] = steady->numbers[i];
                    for (long i = 0; i < wide; i++) numbers[steady->count + i] = factor[i][0];
                    numbers[steady->count + wide] = state.dt;
                    steady->setup(numbers, c);
                    for (long i = 0; i < dims * dims; i++) innovation[i] = told[RESIDUAL + dims + i];
                    state.settled = 1;
                }
                for (long i = 0; i < wide; i++) before[i] = factor[i];
            }
        }
        for (int lane = 0; lane < lanes; lane++) {
            put(now, r->size, lane, r->state + (first + lane) * r->size);
            if (r->total) r->total[first + lane] = total[lane];
        }
    }
}

typedef struct {
    long tracks, steps, points, n, size; /* numbers of the mean, rows of the factor, numbers of a row */
    Back back;
    const R *c;
    Series mean, factor, rest, fault, dt, u; /* filtered, of all steps; a fault as a number */
    R *new_mean, *new_factor, *new_rest;
    signed char *failed;
    long workspace;
} Smoothing;

static void put_smoothed(const Smoothing *s, const V *state, V failed, long first, int lanes, long t) {
    for (int lane = 0; lane < lanes; lane++) {
        const long at = (first + lane) * s->steps + t;
        put(state, s->points, lane, s->new_mean + at * s->points);
        put_factor(state + s->points, s->n, lane, s->new_factor + at * s->n * s->n);
        put(state + s->size - s->rest.size, s->rest.size, lane, s->new_rest + at * s->rest.size);
        s->failed[at] = (signed char)failed[lane];
    }
}

/* Mean, lower factor and the rest of a step into a state. */
static void gather_state(const Smoothing *s, long first, long end, long t, V *wide, V *to) {
    gather(&s->mean, first, end, t, to);
    gather(&s->factor, first, end, t, wide);
    to += s->points;
    for (long i = 0; i < s->n; i++)
        for (long j = 0; j <= i; j++) *to++ = wide[i * s->n + j];
    gather(&s->rest, first, end, t, to);
}

/* Backwards over the tracks [first, end). `given` is dt, inputs and the fault of the later step. */
void backwards(const Smoothing *s, long first, long end) {
    V *const buffers = room(3 * s->size + s->n * s->n + 3 + s->u.size + s->workspace);
    V *const state = buffers + 2 * s->size, *const wide = state + s->size, *const given = wide + s->n * s->n;
    V *const told = given + 2 + s->u.size, *const w = told + 1;
    for (; first < end; first += W) {
        const int lanes = first + W <= end ? W : (int)(end - first);
        V *later = buffers, *next = buffers + s->size;
        gather_state(s, first, end, s->steps - 1, wide, later);
        put_smoothed(s, later, K(0), first, lanes, s->steps - 1);
        for (long t = s->steps - 2; t >= 0; t--) {
            gather_state(s, first, end, t, wide, state);
            gather(&s->dt, first, end, t + 1, given);
            gather(&s->u, first, end, t + 1, given + 1);
            gather(&s->fault, first, end, t + 1, given + 1 + s->u.size);
            s->back(s->c, w, state, later, given, next, told);
            V *swapped = later;
            later = next, next = swapped;
            put_smoothed(s, later, told[0], first, lanes, t);
        }
    }
}

/* Factors that lie `per` numbers apart, n by n, or packed: then their rows end at the diagonal. */
typedef struct {
    long n, per, packed;
    const R *factor;
    R *cov;
} Squares;

/* Covariances P = S S' of lower factors S. */
void squares(const Squares *s, long first, long end) {
    const long n = s->n;
    for (long k = first; k < end; k++) {
        const R *row = s->factor + k * s->per;
        R *P = s->cov + k * n * n;
        for (long i = 0; i < n; row += s->packed ? ++i : (i++, n)) {
            const R *other = s->factor + k * s->per;
            for (long j = 0; j <= i;) {
                R sum = 0;
                for (long l = 0; l <= j; l++) sum += row[l] * other[l];
                P[i * n + j] = P[j * n + i] = sum;
                j++;
                other += s->packed ? j : n;
            }
        }
    }
}

typedef void (*Map)(const R *c, V *w, const V *given, V *made, V *told);

typedef struct {
    Map map;
    const R *c;
    Series given;
    long size;
    R *made;
    long workspace;
} Rows;

/* A step applied to each row of an array. */
void rows(const Rows *r, long first, long end) {
    V *const given = room(r->given.size + r->size + 1 + r->workspace), *const made = given + r->given.size;
    V *const told = made + r->size, *const w = told + 1;
    for (; first < end; first += W) {
        const int lanes = first + W <= end ? W : (int)(end - first);
        gather(&r->given, first, end, 0, given);
        r->map(r->c, w, given, made, told);
        for (int lane = 0; lane < lanes; lane++) put(made, r->size, lane, r->made + (first + lane) * r->size);
    }
}

/* One lane beside the other without regard to where they lie. */
typedef R U __attribute__((vector_size(BYTES), may_alias, aligned(sizeof(R))));

typedef struct {
    Map map;
    const R *c;
    long steps, parts, size;
    const Series *part; /* what it is given, one after the other */
    U *sums;            /* (steps, size), a lane each; added to */
    long workspace;
} Totals;

/* A function of what arrays hold of a track and step, added up by step over the tracks [first, end). */
void totals(const Totals *s, long first, long end) {
    long wide = 0;
    for (long p = 0; p < s->parts; p++) wide += s->part[p].size;
    V *const given = room(wide + s->size + 1 + s->workspace), *const made = given + wide, *const told = made + s->size;
    V *const w = told + 1, lane;
    for (int i = 0; i < W; i++) lane[i] = i;
    for (; first < end; first += W) {
        const M there = v_less(lane, K((R)(end - first)));
        for (long t = 0; t < s->steps; t++) {
            V *to = given;
            for (long p = 0; p < s->parts; to += s->part[p++].size) gather(s->part + p, first, end, t, to);
            s->map(s->c, w, given, made, told);
            U *sum = s->sums + t * s->size;
            for (long i = 0; i < s->size; i++) sum[i] += v_select(there, made[i], K(0));
        }
    }
}
