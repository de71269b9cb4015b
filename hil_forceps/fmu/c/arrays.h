/* What the translated kernels take for granted of Python and numpy: arrays, and a few functions of numbers.
   Arrays that a kernel makes lie in an arena, which is a part of the instance: nothing is taken from the heap. */
#ifndef HF_ARRAYS_H
#define HF_ARRAYS_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define HF_ARENA_DOUBLES 16384
#define HF_UNUSED __attribute__((unused))
#if !defined(__GNUC__) && !defined(__clang__)
#undef HF_UNUSED
#define HF_UNUSED
#endif

typedef struct {
    size_t used;
    bool full; /* more was asked for than there is: what was computed since is worthless */
    double at[HF_ARENA_DOUBLES];
} Arena;

typedef struct {
    double *at;
    int64_t n;
} Array1;

typedef struct {
    double *at;
    int64_t rows, columns, row_step, column_step;
} Array2;

HF_UNUSED static double *hf_room(Arena *arena, int64_t count) {
    if (count < 0 || (uint64_t)count > HF_ARENA_DOUBLES - arena->used) {
        arena->full = true;
        arena->used = 0;
        if (count < 0 || count > HF_ARENA_DOUBLES) {
            count = 0;
        }
    }
    double *at = arena->at + arena->used;
    arena->used += (size_t)count;
    for (int64_t i = 0; i < count; i++) {
        at[i] = 0.0;
    }
    return at;
}

HF_UNUSED static Array1 hf_array1(Arena *arena, int64_t n) {
    Array1 a = {hf_room(arena, n), n};
    return a;
}

HF_UNUSED static Array2 hf_array2(Arena *arena, int64_t rows, int64_t columns) {
    Array2 a = {hf_room(arena, rows * columns), rows, columns, columns, 1};
    return a;
}

HF_UNUSED static Array2 hf_eye(Arena *arena, int64_t n) {
    Array2 a = hf_array2(arena, n, n);
    for (int64_t i = 0; i < n; i++) {
        a.at[i * n + i] = 1.0;
    }
    return a;
}

HF_UNUSED static Array1 hf_full(Arena *arena, int64_t n, double value) {
    Array1 a = hf_array1(arena, n);
    for (int64_t i = 0; i < n; i++) {
        a.at[i] = value;
    }
    return a;
}

HF_UNUSED static Array1 hf_slice1(Array1 a, int64_t first, int64_t end) {
    Array1 part = {a.at + first, end - first};
    return part;
}

HF_UNUSED static Array2 hf_slice2(Array2 a, int64_t row, int64_t row_end, int64_t column, int64_t column_end) {
    Array2 part = {a.at + row * a.row_step + column * a.column_step, row_end - row, column_end - column, a.row_step,
                   a.column_step};
    return part;
}

HF_UNUSED static Array1 hf_row(Array2 a, int64_t row) {
    Array1 part = {a.at + row * a.row_step, a.columns};
    return part;
}

HF_UNUSED static Array2 hf_transposed(Array2 a) {
    Array2 other = {a.at, a.columns, a.rows, a.column_step, a.row_step};
    return other;
}

HF_UNUSED static Array2 hf_shaped(Array1 a, int64_t rows, int64_t columns) {
    Array2 other = {a.at, rows, columns, columns, 1};
    return other;
}

HF_UNUSED static void hf_assign1(Array1 to, Array1 from) {
    for (int64_t i = 0; i < to.n; i++) {
        to.at[i] = from.at[i];
    }
}

HF_UNUSED static Array1 hf_scaled1(Arena *arena, Array1 a, double by) {
    Array1 scaled = hf_array1(arena, a.n);
    for (int64_t i = 0; i < a.n; i++) {
        scaled.at[i] = a.at[i] * by;
    }
    return scaled;
}

HF_UNUSED static Array2 hf_scaled2(Arena *arena, Array2 a, double by) {
    Array2 scaled = hf_array2(arena, a.rows, a.columns);
    for (int64_t i = 0; i < a.rows; i++) {
        for (int64_t j = 0; j < a.columns; j++) {
            scaled.at[i * a.columns + j] = a.at[i * a.row_step + j * a.column_step] * by;
        }
    }
    return scaled;
}

HF_UNUSED static Array1 hf_copy1(Arena *arena, Array1 a) { return hf_scaled1(arena, a, 1.0); }
HF_UNUSED static Array2 hf_copy2(Arena *arena, Array2 a) { return hf_scaled2(arena, a, 1.0); }

/* Python's min and max: the first of equals, and of what can't be compared. */
HF_UNUSED static double hf_max(double a, double b) { return b > a ? b : a; }
HF_UNUSED static double hf_min(double a, double b) { return b < a ? b : a; }
HF_UNUSED static int64_t hf_max_int(int64_t a, int64_t b) { return b > a ? b : a; }
HF_UNUSED static int64_t hf_min_int(int64_t a, int64_t b) { return b < a ? b : a; }

/* A whole number of doubles as an integer; what no integer holds becomes the smallest one, as on x86. */
HF_UNUSED static int64_t hf_integer(double value) {
    return value >= -9.2233720368547758e18 && value < 9.2233720368547758e18 ? (int64_t)value : INT64_MIN;
}

HF_UNUSED static int64_t hf_floor_div(int64_t a, int64_t b) {
    int64_t q = a / b;
    return a % b != 0 && (a < 0) != (b < 0) ? q - 1 : q;
}

HF_UNUSED static int64_t hf_floor_mod(int64_t a, int64_t b) { return a - hf_floor_div(a, b) * b; }

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
