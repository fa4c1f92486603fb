/* Vector lanes: one track in each. R is the type of a number, V one number of each lane, M one truth
   value of each lane: a mask register where there are such, else all bits set or none. No header is needed: compilers would read it for longer
   than the step. */
#ifndef SIGMAX_LANES
#define SIGMAX_LANES

#if SIGMAX_FLOAT
typedef float R;
typedef int I;
#define BITS_OF_SIZE 0x7fffffff
#define SUFFIX(name) __builtin_##name##f
#define PACKED "ps"
#else
typedef double R;
typedef long long I;
#define BITS_OF_SIZE 0x7fffffffffffffffLL
#define SUFFIX(name) __builtin_##name
#define PACKED "pd"
#endif

#define BYTES SIGMAX_BYTES
#define W ((int)(BYTES / sizeof(R)))

/* A single track takes the narrowest registers, in which a division or a root takes half of the time. It is in all
   lanes. What the vector library takes stays wide: other functions would give other bits. */
#define NARROW (BYTES < SIGMAX_WIDE)
typedef R L __attribute__((vector_size(SIGMAX_WIDE), may_alias));

typedef R V __attribute__((vector_size(BYTES), may_alias));
typedef I B __attribute__((vector_size(BYTES), may_alias)); /* the bits of numbers */

#define INLINE static inline __attribute__((always_inline))

/* One number in all lanes. */
INLINE V K(R x) { return x - (V){0}; }

#if BYTES == 64 || defined(__AVX512VL__)
#if SIGMAX_FLOAT
typedef unsigned short M;
#else
typedef unsigned char M;
#endif
#define ALL ((M)((1 << W) - 1))
#define COMPARE(name, predicate)                                                                       \
    INLINE M name(V a, V b) {                                                                          \
        M m;                                                                                           \
        __asm__("vcmp" PACKED " %3, %2, %1, %0" : "=k"(m) : "v"(a), "v"(b), "i"(predicate));           \
        return m;                                                                                      \
    }
COMPARE(v_equal, 0)
COMPARE(v_less, 1)
COMPARE(v_at_most, 2)
COMPARE(v_unequal, 4)
INLINE V v_select(M m, V a, V b) {
    V r;
    __asm__("vblendm" PACKED " %2, %1, %0%{%3%}" : "=v"(r) : "v"(b), "v"(a), "Yk"(m));
    return r;
}
INLINE int v_any(M m) { return m != 0; }
#else
typedef B M;
#define ALL ((M){0} - 1)
INLINE M v_equal(V a, V b) { return a == b; }
INLINE M v_less(V a, V b) { return a < b; }
INLINE M v_at_most(V a, V b) { return a <= b; }
INLINE M v_unequal(V a, V b) { return a != b; }
INLINE V v_select(M m, V a, V b) { return (V)((m & (M)a) | (~m & (M)b)); }
INLINE int v_any(M m) {
    I found = 0;
    for (int lane = 0; lane < W; lane++) found |= m[lane];
    return found != 0;
}
#endif

/* Truth values as the numbers 1 and 0, and back. */
INLINE V v_number(M m) { return v_select(m, K(1), K(0)); }
INLINE M v_truth(V a) { return v_unequal(a, K(0)); }

INLINE V v_abs(V a) { return (V)((B)a & ((B){0} + BITS_OF_SIZE)); }
INLINE M v_finite(V a) { return v_less(v_abs(a), K(__builtin_inf())); }
/* Of two zeros the larger is the one without a sign. */
INLINE V v_max(V a, V b) {
    V either = v_select(v_equal(a, b), (V)((B)a & (B)b), b);
    return v_select(v_less(b, a) | v_unequal(a, a), a, either);
}
INLINE V v_min(V a, V b) {
    V either = v_select(v_equal(a, b), (V)((B)a | (B)b), b);
    return v_select(v_less(a, b) | v_unequal(a, a), a, either);
}
INLINE V v_sign(V a) { return v_select(v_less(K(0), a), K(1), v_select(v_less(a, K(0)), K(-1), a)); }

#define EACH(name, expression)                  \
    INLINE V name(V a) {                        \
        V r;                                    \
        for (int i = 0; i < W; i++) {           \
            R x = a[i];                         \
            r[i] = expression;                  \
        }                                       \
        return r;                               \
    }

#ifdef __AVX__
#if BYTES == 64
#define ROUNDED "vrndscale" PACKED
#define REGISTER "v"
#else
#define ROUNDED "vround" PACKED
#define REGISTER "x"
#endif
#define ONE(name, instruction) \
    INLINE V name(V a) { V r; __asm__(instruction " %1, %0" : "=" REGISTER(r) : REGISTER(a)); return r; }
ONE(v_sqrt, "vsqrt" PACKED)
ONE(v_rint, ROUNDED " $8,")
ONE(v_floor, ROUNDED " $9,")
ONE(v_ceil, ROUNDED " $10,")
ONE(v_trunc, ROUNDED " $11,")
#else
EACH(v_sqrt, SUFFIX(sqrt)(x))
EACH(v_rint, SUFFIX(rint)(x))
EACH(v_floor, SUFFIX(floor)(x))
EACH(v_ceil, SUFFIX(ceil)(x))
EACH(v_trunc, SUFFIX(trunc)(x))
#endif

/* Halves away from zero; zeros keep their sign. */
INLINE V v_round(V a) {
    V size = v_abs(a), whole = v_trunc(size);
    V up = v_select(v_at_most(K(0.5), size - whole), whole + K(1), whole);
    return (V)((B)up | ((B)a & ~((B){0} + BITS_OF_SIZE)));
}

/* Integers: NaN is 0, and no zero has a sign. */
INLINE V v_integer(V a) { return v_select(v_equal(a, a), v_trunc(a) + K(0), K(0)); }
INLINE V v_quotient(V a, V b) { return v_trunc(a / b); }

/* Apart, for compilers fuse multiplications with additions of the same block alone, and a loop ends it. */
static __attribute__((noinline)) V v_look_up(const R *table, V at) {
    V r = at;
    if (NARROW) return K(table[(long)at[0]]);
    for (int i = 0; i < W; i++) r[i] = table[(long)at[i]];
    return r;
}

/* A function of the mathematical library: over vectors where there is one, else lane by lane. */
#define LANE_BY_LANE(name)                                          \
    static __attribute__((noinline)) V v_##name(V a) {              \
        V r = a;                                                    \
        if (NARROW) return K(SUFFIX(name)(a[0]));                   \
        for (int i = 0; i < W; i++) r[i] = SUFFIX(name)(a[i]);      \
        return r;                                                   \
    }
#define LANE_BY_LANE_2(name)                                              \
    static __attribute__((noinline)) V v_##name(V a, V b) {               \
        V r = a;                                                          \
        if (NARROW) return K(SUFFIX(name)(a[0], b[0]));                   \
        for (int i = 0; i < W; i++) r[i] = SUFFIX(name)(a[i], b[i]);      \
        return r;                                                         \
    }
#if BYTES < SIGMAX_WIDE
#define WIDENED(a) ((a)[0] - (L){0})
#define NARROWED(a) K((a)[0])
#else
#define WIDENED(a) (a)
#define NARROWED(a) (a)
#endif
#define VECTOR(name, symbol) \
    L symbol(L);             \
    INLINE V v_##name(V a) { return NARROWED(symbol(WIDENED(a))); }
#define VECTOR_2(name, symbol) \
    L symbol(L, L);            \
    INLINE V v_##name(V a, V b) { return NARROWED(symbol(WIDENED(a), WIDENED(b))); }

#endif
