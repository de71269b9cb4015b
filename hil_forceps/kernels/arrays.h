/* What the translated kernels take for granted of Python: room for arrays, and a few functions of numbers.
   Arrays that a kernel makes lie in an arena, which its caller has: nothing is taken from the heap. */
#ifndef HF_ARRAYS_H
#define HF_ARRAYS_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(__GNUC__) || defined(__clang__)
#define HF_UNUSED __attribute__((unused))
#else
#define HF_UNUSED
#define restrict
#endif

typedef struct {
    size_t used, size; /* doubles */
    bool full;         /* more was asked for than there is: what was computed since is worthless */
    bool unequal;      /* sizes of arrays that don't go together: the same */
    double *at;
} Arena;

HF_UNUSED static void *hf_room(Arena *arena, int64_t count) {
    if (count < 0 || (uint64_t)count > arena->size - arena->used) {
        arena->full = true;
        arena->used = 0;
        if (count < 0 || (uint64_t)count > arena->size) {
#ifdef HF_OVERFLOW_TO_HEAP
            return calloc(count < 0 ? 1 : (size_t)count, sizeof(double)); /* lost: a mistake that its caller tells */
#else
            count = 0;
#endif
        }
    }
    double *at = arena->at + arena->used;
    arena->used += (size_t)count;
    memset(at, 0, (size_t)count * sizeof *at);
    return at;
}

/* A place counted from the end where it is negative; an end of a slice within the array; the size of two that go
   together, of which one may have a single row. */
HF_UNUSED static int64_t hf_place(int64_t i, int64_t size) { return i < 0 ? i + size : i; }
HF_UNUSED static int64_t hf_end(int64_t i, int64_t size) {
    i = i < 0 ? i + size : i;
    return i < 0 ? 0 : i > size ? size : i;
}
HF_UNUSED static int64_t hf_span(int64_t first, int64_t end) { return end > first ? end - first : 0; }
HF_UNUSED static int64_t hf_common(Arena *arena, int64_t a, int64_t b) {
    if (a != b && a != 1 && b != 1) {
        arena->unequal = true;
        return a < b ? a : b;
    }
    return a == 1 ? b : a;
}

/* Python's min and max: the first of equals, and of what can't be compared. */
HF_UNUSED static double hf_max(double a, double b) { return b > a ? b : a; }
HF_UNUSED static double hf_min(double a, double b) { return b < a ? b : a; }
/* numpy's: what is no number stays. */
HF_UNUSED static double hf_least(double a, double b) { return isnan(b) || b < a ? b : a; }
HF_UNUSED static int64_t hf_max_int(int64_t a, int64_t b) { return b > a ? b : a; }
HF_UNUSED static int64_t hf_min_int(int64_t a, int64_t b) { return b < a ? b : a; }

/* A whole number of doubles as an integer; what no integer holds becomes the smallest one, as on x86. */
HF_UNUSED static int64_t hf_integer(double value) {
    return value >= -9.2233720368547758e18 && value < 9.2233720368547758e18 ? (int64_t)value : INT64_MIN;
}

HF_UNUSED static int64_t hf_floor_div(int64_t a, int64_t b) {
    if (b == 0) { /* as numba's numpy model has it */
        return 0;
    }
    int64_t q = a / b;
    return a % b != 0 && (a < 0) != (b < 0) ? q - 1 : q;
}

HF_UNUSED static int64_t hf_floor_mod(int64_t a, int64_t b) {
    return b == 0 ? 0 : a - hf_floor_div(a, b) * b;
}

HF_UNUSED static double hf_sign(double a) { return a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : a == 0.0 ? 0.0 : NAN; }

HF_UNUSED static double hf_square(double a) { return a * a; }

HF_UNUSED static double hf_power(double base, int64_t exponent) {
    double result = 1.0;
    uint64_t left = exponent < 0 ? (uint64_t)(-exponent) : (uint64_t)exponent;
    for (; left > 0; left >>= 1) {
        if (left & 1) {
            result *= base;
        }
        base *= base;
    }
    return exponent < 0 ? 1.0 / result : result;
}

#endif
