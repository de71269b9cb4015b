/* An instance of a unit, as both versions of the standard see it: values by their references, a memory, and a phase.
   Behind `unit.h`, which is written for one unit: its kernels, its variables and what they start with. */
#ifndef HF_INSTANCE_H
#define HF_INSTANCE_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "unit.h"

#define HF_ROOM_DOUBLES 16384

typedef enum { HF_CREATED = 1, HF_INITIALIZING, HF_STEPPING, HF_ENDED } Phase;

/* What a saved state holds. */
typedef struct {
    char token[40];
    uint64_t sum; /* of all that follows: a saved state that was damaged is refused */
    double time_s;
    int64_t phase, changed;
    double values[HF_VALUES];
    double memory[HF_MEMORY];
} Saved;

typedef struct Instance {
    Saved now;
    char *name;
    void *environment;
    void (*say)(const struct Instance *, const char *); /* tells an error */
    void (*logger)(void);                               /* of the environment, in its own type */
    bool logging;
    double room[HF_ROOM_DOUBLES]; /* for the kernels' arrays: nothing is taken from the heap */
} Instance;

static void hf_reset(Instance *it) {
    memset(&it->now, 0, sizeof it->now);
    strncpy(it->now.token, HF_TOKEN, sizeof it->now.token - 1);
    memcpy(it->now.values, hf_starts, sizeof it->now.values);
    it->now.phase = HF_CREATED;
    it->now.changed = 1;
}

static Instance *hf_new(const char *name, const char *token, void *environment, bool logging) {
    if (token == NULL || strcmp(token, HF_TOKEN) != 0) {
        return NULL;
    }
    Instance *it = calloc(1, sizeof *it);
    size_t length = name == NULL ? 0 : strlen(name);
    char *copy = malloc(length + 1);
    if (it == NULL || copy == NULL) {
        free(it);
        free(copy);
        return NULL;
    }
    memcpy(copy, name == NULL ? "" : name, length + 1);
    it->name = copy;
    it->environment = environment;
    it->logging = logging;
    hf_reset(it);
    return it;
}

static void hf_free(Instance *it) {
    if (it != NULL) {
        free(it->name);
        free(it);
    }
}

static bool hf_fail(const Instance *it, const char *message) {
    if (it->logging) {
        it->say(it, message);
    }
    return false;
}

/* Run a kernel of the unit; false, and told, where it finds a problem. */
static bool hf_kernel(Instance *it, int64_t (*kernel)(Arena *, const Doubles1 *, const Doubles1 *, int64_t), int64_t time_ns) {
    Doubles1 values = {it->now.values, HF_VALUES}, memory = {it->now.memory, HF_MEMORY};
    Arena arena = {0, HF_ROOM_DOUBLES, false, false, it->room};
    int64_t problem = kernel(&arena, &values, &memory, time_ns);
    if (arena.full || arena.unequal) {
        return hf_fail(it, "the parameters are out of all range: the plant's response can't be computed");
    }
    return problem == 0 ? true : hf_fail(it, hf_problems[problem - 1]);
}

/* What is known at the end of the initialisation, computed when it is asked for. */
static bool hf_initialized(Instance *it) {
    if (it->now.phase != HF_INITIALIZING || !it->now.changed) {
        return true;
    }
    it->now.changed = 0;
    return hf_kernel(it, hf_begin, 0);
}

static bool hf_get(Instance *it, uint32_t place, char kind, double *value) {
    if (place >= HF_VALUES || hf_kinds[place] != kind) {
        return hf_fail(it, "there is no variable of this type with this value reference");
    }
    if (!hf_initialized(it)) {
        return false;
    }
    *value = it->now.values[place];
    return true;
}

static bool hf_set(Instance *it, uint32_t place, char kind, double value) {
    if (place >= HF_VALUES || hf_kinds[place] != kind) {
        return hf_fail(it, "there is no variable of this type with this value reference");
    }
    char message[200];
    char role = hf_roles[place];
    if (role == 'o' || (role == 'f' && it->now.phase != HF_CREATED && it->now.phase != HF_INITIALIZING)) {
        snprintf(message, sizeof message, "%.80s can't be set %s", hf_names[place], role == 'o' ? "at all" : "any more");
        return hf_fail(it, message);
    }
    if (!(value >= hf_minima[place] && value <= hf_maxima[place])) {
        snprintf(message, sizeof message, "%.80s is %g, must be %g to %g", hf_names[place], value, hf_minima[place],
                 hf_maxima[place]);
        return hf_fail(it, message);
    }
    if (it->now.values[place] != value && (role != 'i' || it->now.phase != HF_STEPPING)) {
        it->now.changed = 1;
    }
    it->now.values[place] = value;
    return true;
}

static bool hf_enter(Instance *it, double start_s) {
    if (it->now.phase != HF_CREATED) {
        return hf_fail(it, "the initialisation can be entered once only; reset first");
    }
    it->now.phase = HF_INITIALIZING;
    it->now.time_s = start_s;
    return true;
}

static bool hf_exit(Instance *it) {
    if (it->now.phase != HF_INITIALIZING) {
        return hf_fail(it, "the initialisation was not entered");
    }
    if (!hf_initialized(it)) {
        return false;
    }
    it->now.phase = HF_STEPPING;
    return true;
}

/* How many samples a step has; 0, and told, where it is no whole number of them. */
static int64_t hf_samples(Instance *it, double step_s) {
    if (HF_SAMPLE_TIME_PLACE < 0) {
        return 1;
    }
    double sample_s = it->now.values[HF_SAMPLE_TIME_PLACE < 0 ? 0 : HF_SAMPLE_TIME_PLACE];
    double samples = step_s / sample_s, whole = floor(samples + 0.5);
    if (!(whole >= 1.0 && whole < 1e15 && fabs(samples - whole) <= 1e-6 * whole)) {
        char message[200];
        snprintf(message, sizeof message, "the communication step is %.9g s, must be a multiple of %s, %.9g s", step_s,
                 hf_names[HF_SAMPLE_TIME_PLACE < 0 ? 0 : HF_SAMPLE_TIME_PLACE], sample_s);
        hf_fail(it, message);
        return 0;
    }
    return (int64_t)whole;
}

static bool hf_step(Instance *it, double start_s, double step_s) {
    if (it->now.phase != HF_STEPPING) {
        return hf_fail(it, "a step can be done after the initialisation only");
    }
    if (!(step_s > 0.0 && fabs(start_s) < 9e9 && step_s < 9e9)) {
        return hf_fail(it, "time and communication step must be finite, the step positive");
    }
    if (fabs(start_s - it->now.time_s) > 1e-6 * step_s + 1e-12 * fabs(start_s)) {
        return hf_fail(it, "the step does not start where the last one ended");
    }
    if (it->now.changed) {
        it->now.changed = 0;
        if (!hf_kernel(it, hf_prepare, 0)) {
            return false;
        }
    }
    int64_t time_ns = (int64_t)floor(start_s * 1e9 + 0.5);
    for (int64_t left = hf_samples(it, step_s); left > 0; left--) {
        if (!hf_kernel(it, hf_advance, time_ns)) {
            return false;
        }
        if (left == 1) {
            it->now.time_s = start_s + step_s;
            return true;
        }
    }
    return false;
}

static uint64_t hf_sum(const Saved *saved) {
    uint64_t sum = 14695981039346656037u; /* FNV-1a */
    const unsigned char *at = (const unsigned char *)&saved->time_s, *end = (const unsigned char *)(saved + 1);
    for (; at < end; at++) {
        sum = (sum ^ *at) * 1099511628211u;
    }
    return sum;
}

static bool hf_save(const Instance *it, void **state) {
    Saved *saved = *state == NULL ? malloc(sizeof *saved) : *state;
    if (saved == NULL) {
        return hf_fail(it, "no memory is left for a state");
    }
    *saved = it->now;
    *state = saved;
    return true;
}

static bool hf_restore(Instance *it, const void *state) {
    if (state == NULL) {
        return hf_fail(it, "there is no state");
    }
    it->now = *(const Saved *)state;
    return true;
}

static bool hf_serialize(const Instance *it, const void *state, void *bytes, size_t size) {
    if (state == NULL || size < sizeof(Saved)) {
        return hf_fail(it, "there is no state, or not enough room for it");
    }
    Saved saved = *(const Saved *)state;
    saved.sum = hf_sum(&saved);
    memcpy(bytes, &saved, sizeof saved);
    return true;
}

static bool hf_deserialize(const Instance *it, const void *bytes, size_t size, void **state) {
    Saved *saved = size == sizeof *saved ? malloc(sizeof *saved) : NULL;
    if (saved == NULL) {
        return hf_fail(it, "the bytes are no state of this unit");
    }
    memcpy(saved, bytes, sizeof *saved);
    if (memcmp(saved->token, HF_TOKEN, strlen(HF_TOKEN) + 1) != 0 || saved->sum != hf_sum(saved)) {
        free(saved);
        return hf_fail(it, "the bytes are no state of this unit");
    }
    free(*state);
    *state = saved;
    return true;
}

#endif
