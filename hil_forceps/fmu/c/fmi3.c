/* A unit by FMI 3.0, co-simulation without events. All that it doesn't offer answers with an error. */
#include "fmi3Functions.h"

#include "instance.h"

#define UNUSED(x) (void)(x)
#define STATUS(fine) ((fine) ? fmi3OK : fmi3Error)

static void say(const Instance *it, const char *message) {
    fmi3LogMessageCallback logger = (fmi3LogMessageCallback)it->logger;
    if (logger != NULL) {
        logger(it->environment, fmi3Error, "logStatusError", message);
    }
}

static fmi3Status not_offered(fmi3Instance it) {
    hf_fail(it, "this function is not offered");
    return fmi3Error;
}

#include "fmi3_not_offered.h"

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance it, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    UNUSED(it), UNUSED(on), UNUSED(n), UNUSED(categories);
    return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
                                         fmi3IntermediateUpdateCallback update) {
    UNUSED(resources), UNUSED(visible), UNUSED(logging), UNUSED(early_return), UNUSED(intermediate), UNUSED(update);
    Instance *it = !event_mode && n == 0 ? hf_new(name, token, environment, true) : NULL;
    if (it != NULL) {
        it->logger = (void (*)(void))logger;
        it->say = say;
    } else if (logger != NULL) {
        logger(environment, fmi3Error, "logStatusError",
               "no event mode, no intermediate variables, and the token of the model description");
    }
    return it;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback logger) {
    UNUSED(name), UNUSED(token), UNUSED(resources), UNUSED(visible), UNUSED(logging);
    if (logger != NULL) {
        logger(environment, fmi3Error, "logStatusError", "co-simulation only");
    }
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
                                               fmi3ClockUpdateCallback clock_update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock) {
    UNUSED(name), UNUSED(token), UNUSED(resources), UNUSED(visible), UNUSED(logging);
    UNUSED(clock_update), UNUSED(lock), UNUSED(unlock);
    if (logger != NULL) {
        logger(environment, fmi3Error, "logStatusError", "co-simulation only");
    }
    return NULL;
}

void fmi3FreeInstance(fmi3Instance it) { hf_free(it); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance it, fmi3Boolean has_tolerance, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop) {
    UNUSED(has_tolerance), UNUSED(tolerance), UNUSED(has_stop), UNUSED(stop);
    return STATUS(hf_enter(it, start));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance it) { return STATUS(hf_exit(it)); }

fmi3Status fmi3Terminate(fmi3Instance it) {
    ((Instance *)it)->now.phase = HF_ENDED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance it) {
    hf_reset(it);
    return fmi3OK;
}

#define GETTER(Name, Type, kind)                                                                              \
    fmi3Status fmi3Get##Name(fmi3Instance it, const fmi3ValueReference places[], size_t n, Type values[],     \
                             size_t n_values) {                                                               \
        if (n != n_values) {                                                                                  \
            return STATUS(hf_fail(it, "as many values as references are needed"));                            \
        }                                                                                                     \
        for (size_t i = 0; i < n; i++) {                                                                      \
            double found = 0.0;                                                                               \
            if (!hf_get(it, places[i], kind, &found)) {                                                       \
                return fmi3Error;                                                                             \
            }                                                                                                 \
            values[i] = (Type)found;                                                                          \
        }                                                                                                     \
        return fmi3OK;                                                                                        \
    }
#define SETTER(Name, Type, kind)                                                                              \
    fmi3Status fmi3Set##Name(fmi3Instance it, const fmi3ValueReference places[], size_t n, const Type values[], \
                             size_t n_values) {                                                               \
        if (n != n_values) {                                                                                  \
            return STATUS(hf_fail(it, "as many values as references are needed"));                            \
        }                                                                                                     \
        for (size_t i = 0; i < n; i++) {                                                                      \
            if (!hf_set(it, places[i], kind, (double)values[i])) {                                            \
                return fmi3Error;                                                                             \
            }                                                                                                 \
        }                                                                                                     \
        return fmi3OK;                                                                                        \
    }

GETTER(Int32, fmi3Int32, 'i')
GETTER(Boolean, fmi3Boolean, 'b')
SETTER(Float64, fmi3Float64, 'r')
SETTER(Int32, fmi3Int32, 'i')
SETTER(Boolean, fmi3Boolean, 'b')

/* Time, the independent variable, is a value of its own behind the others. */
fmi3Status fmi3GetFloat64(fmi3Instance it, const fmi3ValueReference places[], size_t n, fmi3Float64 values[],
                          size_t n_values) {
    if (n != n_values) {
        return STATUS(hf_fail(it, "as many values as references are needed"));
    }
    for (size_t i = 0; i < n; i++) {
        if (places[i] == HF_VALUES) {
            values[i] = ((Instance *)it)->now.time_s;
        } else if (!hf_get(it, places[i], 'r', &values[i])) {
            return fmi3Error;
        }
    }
    return fmi3OK;
}

fmi3Status fmi3GetFMUState(fmi3Instance it, fmi3FMUState *state) { return STATUS(hf_save(it, state)); }
fmi3Status fmi3SetFMUState(fmi3Instance it, fmi3FMUState state) { return STATUS(hf_restore(it, state)); }

fmi3Status fmi3FreeFMUState(fmi3Instance it, fmi3FMUState *state) {
    UNUSED(it);
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance it, fmi3FMUState state, size_t *size) {
    UNUSED(it), UNUSED(state);
    *size = sizeof(Saved);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance it, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    return STATUS(hf_serialize(it, state, bytes, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance it, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
    return STATUS(hf_deserialize(it, bytes, size, state));
}

fmi3Status fmi3DoStep(fmi3Instance it, fmi3Float64 start, fmi3Float64 step, fmi3Boolean no_set_before,
                      fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last) {
    UNUSED(no_set_before);
    bool fine = hf_step(it, start, step);
    *event = *terminate = *early = fmi3False;
    *last = ((Instance *)it)->now.time_s;
    return STATUS(fine);
}
